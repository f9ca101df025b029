"""The functions of the model contract from the equations as expressions, and a model's small motions; any model, not only a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi
import numpy as np

from flexfmu.model import time_derivatives
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.trajectories.jets import RealArray


def contract_functions(
    motion: time_derivatives.MotionSymbols,
    residual: casadi.SX,
    outputs: casadi.SX,
    parameters: tuple[casadi.SX, casadi.SX],
    start: tuple[casadi.SX, casadi.SX, casadi.SX],
    margin: casadi.SX,
    error_scale: casadi.SX,
    iterated: tuple[casadi.SX, casadi.SX] | None = None,
) -> Mapping[str, casadi.Function]:
    """The functions of `flexfmu.model.symbolic.FUNCTION_SIGNATURES`.

    Args:
        motion: symbols of y, v, a (n, 1) and u (m, 1).
        residual: r(y, v, a, u, d) (n, 1), linear in a with a symmetric mass matrix.
        outputs: outputs (n_outputs, 1).
        parameters: symbols of the parameters p and of the derived values d.
        start: derived values, inputs at the start, and coordinates there (n, 1) or with the rates (2 n, 1), expressions of p.
        margin, error_scale: as `singularity` and `error_scale` there, expressions of y, u, d and of d.
        iterated: symbols that derivatives take as constants, and the expressions that take their place in all results.
    """
    y, v, a, u, (p, d) = motion.y, motion.v, motion.a, motion.u, parameters
    derived, inputs, coordinates = start
    constant = d if iterated is None else casadi.vertcat(d, iterated[0])
    results = {
        "derive": ([p], derived),
        "initial_inputs": ([p], inputs),
        "initial_coordinates": ([p], coordinates),
        "start_forward": time_derivatives.forward([p], casadi.vertcat(derived, coordinates)),
        "residual": ([y, v, a, u, d], residual),
        "mass_matrix": ([y, u, d], casadi.tril2symm(casadi.tril(casadi.jacobian(residual, a)))),
        "outputs": ([y, v, a, u, d], outputs),
        "motion_forward": time_derivatives.motion_forward(motion, residual, outputs, d),
        "motion_rate1": time_derivatives.motion_rate1(motion, residual, outputs, constant),
        "motion_rate2": time_derivatives.motion_rate2(motion, residual, outputs, constant),
        "singularity": ([y, u, d], margin),
        "error_scale": ([d], error_scale),
    }
    functions = {}
    for name, (arguments, result) in results.items():
        taken = [d if each is constant else each for each in arguments]
        closed = result if iterated is None else casadi.substitute(result, *iterated)
        functions[name] = casadi.Function(name, taken, [casadi.densify(casadi.cse(casadi.densify(closed)))])
    return functions


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """dx/dt = A x + B u, y = C x + D u: a model about a point, in deviations from it; the states are coordinates, then rates.

    Attributes:
        a, b, c, d: the matrices.
        inputs, outputs: names of the FMU's variables, in the order of u and y.
        rest: values of the inputs and of the outputs at the point.
    """

    a: RealArray
    b: RealArray
    c: RealArray
    d: RealArray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rest: tuple[RealArray, RealArray]


Point = tuple[RealArray, RealArray, RealArray, RealArray]
"""Coordinates, rates and accelerations (n,), and inputs (m,)."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A model with the Jacobians of residual and outputs by coordinates, rates, accelerations and inputs, functions of these and of the derived
    values; those of its parameters' start values."""

    model: SymbolicModel
    derived: casadi.DM
    residual: casadi.Function
    outputs: casadi.Function

    @classmethod
    def of(cls, model: SymbolicModel, *, is_varied: bool = False) -> Linearisation:
        """The Jacobians of a model; ``is_varied`` is whether `with_values` will be called, which makes them a little slower."""
        n, m = model.degrees_of_freedom, len(model.inputs)
        arguments = [casadi.SX.sym(name, size) for name, size in (("y", n), ("v", n), ("a", n), ("u", m))]
        derived = model.functions["derive"]([each.start or 0.0 for each in model.parameters])
        symbol = casadi.SX.sym("d", derived.numel())

        def jacobians(name: str) -> casadi.Function:
            expression = model.functions[name](*arguments, symbol if is_varied else derived)
            return casadi.Function(name, [*arguments, symbol], [casadi.jacobian(expression, x) for x in arguments])

        return cls(model, derived, jacobians("residual"), jacobians("outputs"))

    def with_values(self, values: Mapping[str, float]) -> Linearisation:
        """With other values of some parameters."""
        return replace(
            self,
            derived=self.model.functions["derive"](
                [values.get(each.name, each.start or 0.0) for each in self.model.parameters]
            ),
        )

    def about(self, point: Point, outputs: Sequence[str]) -> LinearPlant:
        """The model about a point at which its residual is zero, with some of its outputs."""
        names = [variable.name for variable in self.model.outputs]
        rows = [names.index(name) for name in outputs]
        n, m = self.model.degrees_of_freedom, len(self.model.inputs)
        # accelerations as functions of states and inputs: M a + C v + K y + B u = 0
        stiffness, damping, mass, load = (np.asarray(each.full()) for each in self.residual(*point, self.derived))
        response = -np.linalg.solve(mass, np.hstack([stiffness, damping, load]))
        by_state, by_input = response[:, : 2 * n], response[:, 2 * n :]
        # outputs, which depend on the accelerations too
        c_y, c_v, c_a, c_u = (np.asarray(each.full()) for each in self.outputs(*point, self.derived))
        kept = np.array(self.model.states, dtype=int)
        return LinearPlant(
            a=np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), by_state])[np.ix_(kept, kept)],
            b=np.vstack([np.zeros((n, m)), by_input])[kept],
            c=(np.hstack([c_y, c_v]) + c_a @ by_state)[np.ix_(np.array(rows, dtype=int), kept)],
            d=(c_u + c_a @ by_input)[rows],
            inputs=tuple(variable.name for variable in self.model.inputs),
            outputs=tuple(outputs),
            rest=(point[3], np.asarray(self.model.functions["outputs"](*point, self.derived).full())[rows, 0]),
        )
