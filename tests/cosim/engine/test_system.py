"""Wiring: mistakes are named, slaves are sorted by direct feedthrough, algebraic loops are found; linear maps of units and offsets between
slaves change nothing in what the system does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from python_slave import Block

from flexfmu.cosim.engine.errors import InputError, WiringError
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import IDENTITY, LinearMap, System, TableMap, connect
from flexfmu.cosim.engine.slave import TAKES, Indices, RealArray, SlaveVariable, Type


def state(name: str) -> Block:
    """Outputs depend on states alone."""
    return Block(name, y1=(), y2=())


def gain(name: str) -> Block:
    """y1 depends on u1, y2 on u2."""
    return Block(name, y1=("u1",), y2=("u2",))


def names(system: System, order: Sequence[int]) -> list[str]:
    """Slaves in that order."""
    return [system.slaves[i].name for i in order]


@pytest.mark.parametrize("source", TAKES)
@pytest.mark.parametrize("target", TAKES)
def test_types_must_suit(source: Type, target: Type) -> None:
    """Integers go into Reals and enumerations into Integers, as in SSP; nothing is rounded without a word."""
    giver, taker = Block("a"), state("b")
    giver.variables = (SlaveVariable("y", "output", type=source),)
    taker.variables = (SlaveVariable("u", "input", type=target),)
    if source in TAKES[target]:
        assert connect([giver, taker], [("a.y", "b.u")]).connections
        return
    with pytest.raises(
        WiringError, match=rf"types differ: a\.y is {source}, b\.u {target}, which takes {TAKES[target][0]}"
    ) as refused:
        connect([giver, taker], [("a.y", "b.u")])
    assert f'SlaveVariable(.., type="{target}")' in str(refused.value)
    with pytest.raises(WiringError, match="types differ"):
        connect([giver, taker], [("a.y", "b.u", LinearMap(2.0))])


def test_an_unknown_unit_fits() -> None:
    """An FMU without units can be wired."""
    assert connect([Block("a", ""), state("b")], [("a.y1", "b.u1")]).connections


def test_chain_is_sorted_by_feedthrough() -> None:
    """However the slaves are listed, an output is up to date when it is passed on, and none is delayed."""
    system = connect([gain("c"), gain("b"), state("a")], [("b.y1", "c.u1"), ("a.y1", "b.u1")])
    assert names(system, system.step_order) == ["a", "b", "c"]
    assert system.delayed == ()


def test_feedback_through_a_state() -> None:
    """Plant and controller: the plant is read first, and the signal that is delayed over a step is named."""
    wires = [("plant.y1", "controller.u1"), ("controller.y1", "plant.u1")]
    system = connect([gain("controller"), state("plant")], wires)
    assert names(system, system.step_order) == ["plant", "controller"]
    assert [system.describe(each) for each in system.delayed] == ["controller.y1 -> plant.u1"]


def test_crossing_signals_are_no_loop() -> None:
    """Loops are looked for between variables: two gains that serve each other on separate ways are fine."""
    system = connect([gain("a"), gain("b")], [("a.y1", "b.u1"), ("b.y1", "a.u2")])
    assert names(system, system.exchange_order) == ["a", "b", "a"]


@pytest.mark.parametrize("order", [("plant", "pd", "sensor", "motion"), ("motion", "sensor", "pd", "plant")])
def test_nobody_is_visited_to_be_given_inputs_alone(order: Sequence[str]) -> None:
    """Each slave has its turn once all it passes on is there, whatever the order they are given in; the plant once more,
    for the force that its acceleration depends on."""
    parts = (state("motion"), Block("plant", y1=(), y2=("u1",)), gain("sensor"), Block("pd"))
    slaves = {each.name: each for each in parts}
    wires = [("motion.y1", "pd.u1"), ("plant.y1", "sensor.u1"), ("sensor.y1", "pd.u2"), ("pd.y1", "plant.u1")]
    found = names(system := connect([slaves[name] for name in order], wires), system.exchange_steps)
    assert sorted(found) == ["motion", "pd", "plant", "plant", "sensor"]
    assert found.index("plant") < found.index("sensor") < found.index("pd")
    assert found[-1] == "plant"


def test_a_slave_that_feeds_itself_is_visited_again() -> None:
    """Inputs are set before outputs are read: what one output gives to an own input shows in another on the next visit."""
    slaves = [gain("a"), state("s")]
    wired = connect(slaves, [("s.y1", "a.u1"), ("a.y1", "a.u2")])
    assert names(wired, wired.exchange_steps) == ["s", "a", "a"]
    crossed = connect(slaves, [("s.y1", "a.u1"), ("s.y2", "a.u2")])
    assert names(crossed, crossed.exchange_steps) == ["s", "a"]


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
