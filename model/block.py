"""A discrete-time block: a controller, shaper or imperfection as equations, from which both its Python slave and its FMU
are made, so that they give the same numbers.

At its sample instants t_k = offset + k * sample_time a block reads its inputs u, outputs y and updates its states x::

    y_k = output(x_k, u_k, p)        x_{k+1} = update(x_k, u_k, p)

and holds y until the next instant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import casadi

from flexfmu.model.symbolic import Variable


@dataclass(frozen=True)
class SymbolicBlock:
    """A block as equations and variables; a pure value.

    Attributes:
        name: model name.
        description: one sentence.
        sample_time: [s], above zero.
        offset: first sample instant [s], zero or positive.
        inputs, outputs, parameters: variables in the order of u, y and p.
        states: start values of the states x.
        output: CasADi function (x, u, p) → y, all dense column vectors.
        update: CasADi function (x, u, p) → next x.
        feedthrough: for each output the names of the inputs that it depends on at the same instant.
        latency: for outputs that are delayed on purpose by how much they lag at low frequency [s], without the hold.
    """

    name: str
    description: str
    sample_time: float
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    output: casadi.Function
    update: casadi.Function
    parameters: tuple[Variable, ...] = ()
    states: tuple[float, ...] = ()
    offset: float = 0.0
    feedthrough: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    latency: Mapping[str, float] = field(default_factory=dict)
