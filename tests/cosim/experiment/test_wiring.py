"""Wiring by names: who feeds whom, what passes what, and what is said where a name fits nothing."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import WiringError
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.experiment.wiring import Wiring, inline_block, wire


class Names(PythonSlave):
    """A slave that has names and does nothing."""

    def __init__(self, name: str, inputs: Sequence[str] = (), outputs: Sequence[str] = ()) -> None:
        self.variables = (
            *(SlaveVariable(each, "input") for each in inputs),
            *(SlaveVariable(each, "output") for each in outputs),
        )
        super().__init__(name)


TRAJECTORY = Names("trajectory", outputs=["q.reference"])
PLANT = Names("plant", ["torque", "force"], ["q", "v"])
PD = Names("pd", ["q.reference", "q", "q.feedforward"], ["torque"])


def sources(wiring: Wiring) -> dict[str, str]:
    """Input → output."""
    return {target: source for source, target in wiring.connections}


def test_equal_names_are_connected() -> None:
    """References and measurements reach the controller, its torque the plant; what no slave outputs stays at its start."""
    wiring = wire(TRAJECTORY, PLANT, [PD])
    assert sources(wiring) == {
        "pd.q.reference": "trajectory.q.reference",
        "pd.q": "plant.q",
        "plant.torque": "pd.torque",
    }
    assert wiring.feeding == {"torque": "pd.torque"}


def test_signals_pass_in_the_order_given() -> None:
    """Imperfections stand one behind the other, wherever their signal comes from."""
    delay, noise = Names("delay", ["q.input"], ["q"]), Names("noise", ["q.input"], ["q"])
    shaper, amplifier = (
        Names("shaper", ["q.reference"], ["shaped.q.reference"]),
        Names("amplifier", ["torque"], ["torque"]),
    )
    wiring = wire(TRAJECTORY, PLANT, [PD], [inline_block(each) for each in (amplifier, delay, shaper, noise)])
    assert sources(wiring) == {
        "shaper.q.reference": "trajectory.q.reference",
        "pd.q.reference": "shaper.shaped.q.reference",
        "delay.q.input": "plant.q",
        "noise.q.input": "delay.q",
        "pd.q": "noise.q",
        "amplifier.torque": "pd.torque",
        "plant.torque": "amplifier.torque",
    }


@pytest.mark.parametrize(("controllers", "inline_blocks", "explicit", "expected"), [
    ([Names("damper", ["v"], ["torque"])], [Names("encoder", ["q.input"], ["q", "v"])], {}, "encoder.v -> damper.v"),
    ([], [Names("spring", ["q"], ["q"])], {"plant.force": "spring.q"}, "spring.q -> plant.force"),
    ([PD, Names("forward", ["q.reference"], ["q.feedforward"])], [], {}, "forward.q.feedforward -> pd.q.feedforward"),
    ([Names("lqg", ["q_reference", "q"], ["torque"])], [], {}, "trajectory.q.reference -> lqg.q_reference"),
], ids=["two signals made of one", "no controller", "feedforward", "underscores for dots"])  # fmt: skip
def test_sources_are_found(
    controllers: list[Names], inline_blocks: list[Names], explicit: dict[str, str], expected: str
) -> None:
    """An encoder replaces more than it takes; a measurement may move the robot by itself; controllers feed each other first;
    signals of python-control, which knows no dots, find their names."""
    wiring = wire(TRAJECTORY, PLANT, controllers, [inline_block(each) for each in inline_blocks], explicit)
    assert tuple(expected.split(" -> ")) in wiring.connections


def test_nobody_feeds_itself() -> None:
    """A signal that a slave both takes and outputs comes from another source: a second controller, or the trajectory."""
    filtered = Names("filter", ["q.reference", "q"], ["q.reference", "torque"])
    assert sources(wire(TRAJECTORY, PLANT, [filtered]))["filter.q.reference"] == "trajectory.q.reference"
    with pytest.raises(WiringError, match=r"c\.memory has no source"):
        wire(TRAJECTORY, PLANT, [Names("c", ["q", "memory"], ["torque", "memory"])])
    echo = Names("plant", ["torque", "force"], ["q", "force"])
    wiring = wire(TRAJECTORY, echo, [PD])
    assert [target for target in sources(wiring) if target.startswith("plant.")] == ["plant.torque"]
    assert wiring.feeding == {"torque": "pd.torque"}


def test_explicit_connections_come_first() -> None:
    """Foreign names are connected to signals (behind their imperfections) or to a slave's own output."""
    foreign, noise = Names("foreign", ["u1", "u2"], ["y"]), Names("noise", ["q.input"], ["q"])
    explicit = {"foreign.u1": "q", "foreign.u2": "plant.q", "plant.torque": "foreign.y"}
    amplifier = Names("amplifier", ["torque"], ["torque"])
    wiring = wire(TRAJECTORY, PLANT, [foreign], [inline_block(noise), inline_block(amplifier)], explicit)
    assert sources(wiring) == {
        "noise.q.input": "plant.q",
        "foreign.u1": "noise.q",
        "foreign.u2": "plant.q",
        "amplifier.torque": "foreign.y",
        "plant.torque": "amplifier.torque",
    }


def with_units(slave: Names, *units: str) -> Names:
    """The slave with units of its variables."""
    pairs = zip(slave.variables, units, strict=True)
    slave.variables = tuple(SlaveVariable(each.name, each.causality, unit) for each, unit in pairs)
    return slave


def test_units_say_what_fits() -> None:
    """A connection between different units names the signals that would fit, and so does an input without a source."""
    motion = with_units(Names("trajectory", outputs=["q.reference"]), "rad")
    plant = with_units(Names("plant", ["torque"], ["q", "v"]), "N.m", "rad", "rad/s")
    mine = with_units(Names("mine", ["angle"], ["torque"]), "rad", "N.m")
    with pytest.raises(
        WiringError, match=r"plant\.v is in rad/s, mine\.angle is in rad; connect .* in rad \(q\.reference, q\)"
    ):
        wire(motion, plant, [mine], [], {"mine.angle": "v"})
    with pytest.raises(WiringError, match=r"mine\.angle \[rad\] has no source.*in rad there are: q\.reference, q$"):
        wire(motion, plant, [mine])


@pytest.mark.parametrize(("controllers", "inline_blocks", "explicit", "message"), [
    ([Names("c", ["q.refernce"], ["torque"])], [], {}, "c.q.refernce has no source"),
    ([Names("c", ["q.refernce"], ["torque"])], [], {}, "did you mean 'q.reference'"),
    ([Names("c", ["q"], ["torque", "forces"])], [], {}, "c.forces is connected to nothing, and plant.force has no"),
    ([PD, Names("c", [], ["torque"])], [], {}, "pd and c both output torque"),
    ([Names("c", [], ["q"])], [], {}, "c outputs q, but so does the robot: a signal has one source"),
    ([Names("c", ["q"], ["y"])], [], {}, r"\(c\.y\) reaches the robot, which takes torque, force"),
    ([], [Names("n", ["q"], [])], {}, "n has no outputs"),
    ([], [Names("n", ["qq"], ["qq"])], {}, "n acts on qq, which doesn't exist; did you mean 'q'"),
    ([], [Names("n", ["a.torque"], ["a.torque"])], {}, "needs a controller"),
    ([Names("c", ["q"], ["u1"])], [Names("n", ["torque"], ["torque"])], {},
     r"output c\.u1: call the output torque, or"),
    ([], [Names("n", ["q"], ["q"])], {}, "^n acts on q, which nothing takes: add a controller, or leave n out$"),
    ([], [Names("m", ["q"], ["q"]), Names("n", ["q"], ["q"])], {}, "^n acts on q"),
    ([], [Names("s", ["q.reference"], ["shaped.q.reference"])], {}, "^s acts on q.reference, which nothing takes"),
    ([PD], [], {"pd.x": "q"}, "pd has no input 'x'"),
    ([PD], [], {"pdd.q": "q"}, "no slave 'pdd'"),
    ([PD], [], {"pd.q": "plant.qq"}, "plant has no output 'qq'; did you mean 'q'"),
    ([PD], [], {"pd.q": "x"}, "no signal 'x'"),
])  # fmt: skip
def test_what_fits_nothing_is_named(
    controllers: list[Names], inline_blocks: list[Names], explicit: dict[str, str], message: str
) -> None:
    """Every mistake names the slave, the variable and what would do."""
    with pytest.raises(WiringError, match=message):
        wire(TRAJECTORY, PLANT, controllers, [inline_block(each) for each in inline_blocks], explicit)
