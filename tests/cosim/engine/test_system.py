"""Wiring: mistakes are named, slaves are sorted by direct feedthrough, algebraic loops are found."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from python_slave import Block

from flexfmu.cosim.engine.errors import WiringError
from flexfmu.cosim.engine.master.system import LinearMap, System, connect
from flexfmu.cosim.engine.slave import TAKES, SlaveVariable, Type


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
