"""Linear maps on connections: units and offsets between slaves change nothing in what the system does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import IDENTITY, LinearMap, TableMap, connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable

FACTOR, OFFSET = 1024.0, 3.0
"""What the foreign quantity is: FACTOR times ours, plus OFFSET."""


class Foreign:
    """A slave whose outputs are in another unit, with another zero."""

    def __init__(self, slave: Any) -> None:
        self.slave, self.name, self.feedthrough = slave, slave.name, slave.feedthrough
        self.max_input_order, self.max_output_order = slave.max_input_order, slave.max_output_order
        self.variables = tuple(
            SlaveVariable(each.name, each.causality, "foreign" if each.causality == "output" else each.unit, each.start)
            for each in slave.variables
        )

    def __getattr__(self, name: str) -> Any:
        return getattr(self.slave, name)

    def get(self, indices: Indices, values: RealArray) -> None:
        self.slave.get(indices, values)
        values *= FACTOR
        values += OFFSET

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        self.slave.get_derivatives(indices, derivatives)
        derivatives *= FACTOR


@pytest.mark.parametrize("algorithm", [GaussSeidel(), Jacobi(), Implicit()], ids=lambda each: type(each).__name__)
@pytest.mark.parametrize("order", [0, 2])
def test_a_foreign_unit_changes_nothing(split_oscillator: Any, order: int, algorithm: Algorithm) -> None:
    """Values and derivatives are converted, extrapolated or interpolated, whichever way the step is coupled."""
    plain = split_oscillator(order)
    expected = simulate(plain.system(), stop=1.0, step=0.01, algorithm=algorithm)
    system = split_oscillator(order).system()
    slaves: list[Any] = [Foreign(system.slaves[0]), *system.slaves[1:]]
    back = LinearMap(1.0 / FACTOR, -OFFSET / FACTOR)
    wires = [
        (*system.describe(each).split(" -> "), back if each.source == 0 else IDENTITY) for each in system.connections
    ]
    found = simulate(connect(slaves, wires), stop=1.0, step=0.01, algorithm=algorithm)
    assert found.outcome is expected.outcome is Outcome.COMPLETED, found.message
    name = f"{slaves[1].name}.x"
    np.testing.assert_allclose(found.recording[name].values, expected.recording[name].values, rtol=0.0, atol=1e-11)
    assert abs(expected.recording[name].values).max() > 0.1


@pytest.mark.parametrize("factor", [0.1, -0.1])
@pytest.mark.parametrize("order", [0, 2])
def test_the_loop_in_c_maps_the_same_bits(split_oscillator: Any, order: int, factor: float) -> None:
    """Products and sums of values and derivatives are rounded as in Python, signs of zeros included."""
    system = split_oscillator(order).system()
    wires = [(*system.describe(each).split(" -> "), LinearMap(factor, 0.3)) for each in system.connections]
    found, exact = (
        simulate(connect(system.slaves, wires), stop=1.0, step=0.01, algorithm=Jacobi(), compiled=compiled).recording
        for compiled in (True, False)
    )
    for name, column in found.columns.items():
        assert column.values.tobytes() == exact[name].values.tobytes(), name
    assert np.ptp(found[f"{system.slaves[1].name}.x"].values) > 1e-3


def test_maps_follow_one_another() -> None:
    """First one, then the other; the identity leaves the last bit alone."""
    first, second = LinearMap(2.0, 1.0), LinearMap(-3.0, 0.5)
    assert first.then(second)(5.0) == second(first(5.0))
    assert first.then(IDENTITY) is first
    assert IDENTITY.then(second) is second
    assert IDENTITY(0.1 + 0.2) == 0.1 + 0.2
    table = TableMap(((0, 1.0), (1, 0.0), (2, 5.0)))
    scaled = first.then(table).then(second)
    assert [scaled(value) for value in (-0.5, 0.0, 0.5)] == [-2.5, 0.5, -14.5]
    assert [table.then(table)(value) for value in (0.0, 1.0)] == [0.0, 1.0]
    for lost in (lambda: table(3.0), lambda: table(float("nan")), lambda: table.then(table)(2.0)):
        with pytest.raises(InputError, match=r"the table of a connection has nothing for .*, only for 0, 1"):
            lost()
