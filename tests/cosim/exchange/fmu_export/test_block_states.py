"""Rollback, reset, refused calls and failures of exported blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, delay, pd_controller, reciprocal, saturation
from export_support.instance import Instance, RefusedError, run
from export_support.kinds import KINDS

Export = Callable[..., Any]

STEPS = (0.4, 1.0, 0.6, 2.5, 0.5)
"""Communication steps that end on instants and between them, in sample times; together five."""


def play(instance: Instance, seed: int, rounds: int = 8) -> list[list[float]]:
    """Outputs on both sides of setting random inputs, after each of many uneven steps."""
    random = np.random.default_rng(seed)
    rows = []
    for _ in range(rounds):
        for step in STEPS:
            rows.append(instance.get_outputs())
            instance.set_inputs(random.normal(size=len(instance.inputs)))
            instance.set_derivatives(instance.inputs[0], random.normal(size=2))
            rows.append(instance.get_outputs())
            instance.step(step * SAMPLE_TIME)
    return rows


STATEFUL = ("cascade: velocity", "cascade: current", "disturbance-observer")
"""Kinds of the toolkit whose states are their own."""

OF_THE_TOOLKIT = [pytest.param(KINDS[name], id=name) for name in STATEFUL]


@pytest.mark.parametrize("make", [pd_controller, delay, saturation, *OF_THE_TOOLKIT])
@pytest.mark.parametrize("within", [0.0, 0.5], ids=["due", "held"])
def test_restored_state_replays(export: Export, make: Callable[[], Any], within: float) -> None:
    """A master that repeats a step must get the same numbers, bit by bit, also from a sample that is due."""
    instance = export(make())().start()
    play(instance, 1, rounds=2)
    if within:
        instance.step(within * SAMPLE_TIME)
    state, time = instance.call("getFMUstate"), instance.time
    first = play(instance, 2)
    instance.call("setFMUstate", state)
    instance.time = time
    assert play(instance, 2) == first
    instance.call("freeFMUstate", state)


def test_serialized_state_goes_on_elsewhere(export: Export) -> None:
    """A state saved to a file continues in another instance."""
    make = export(pd_controller())
    one, two = make("one").start(), make("two").start()
    play(one, 1)
    state = one.call("getFMUstate")
    data = one.call("serializeFMUstate", state)
    two.call("setFMUstate", two.call("deSerializeFMUstate", data))
    two.time = one.time
    assert play(two, 2) == play(one, 2)
    changed = data[:-9] + bytes([data[-9] ^ 1]) + data[-8:]
    with pytest.raises(RefusedError, match="checksum is wrong"):
        two.call("deSerializeFMUstate", changed)


def test_reset_starts_over(export: Export) -> None:
    """After a reset nothing of the first run is left: states, parameters, inputs, time; nor does another instance leave a trace."""
    make = export(pd_controller())
    instance, other = make().start(), make("other").start(kp=3.0)
    random = np.random.default_rng(9)
    for _ in range(20):
        other.set_inputs(random.normal(size=2))
        other.step(SAMPLE_TIME)
    fresh = play(instance, 3)
    instance.call("terminate")
    instance.call("reset")
    play(instance.start(time=3.0, kp=1.0, in1=5.0), 4)
    instance.call("reset")
    assert play(instance.start(), 3) == fresh == play(make("alone").start(), 3)


def test_bad_values_are_refused_with_a_sentence(export: Export) -> None:
    """Name, value, unit and limits in one line; the instance goes on as if nothing had been said."""
    instance = export(pd_controller())().start()
    instance.set_inputs([1.0, 0.0])
    before = instance.get_outputs()
    for call, sentence in {
        lambda: instance.set("in1", float("nan")): "in1 must be a finite number in 1, got nan",
        lambda: instance.set("kd", 2e3): "kd must be in -1000 .. 1000 1, got 2000",
        lambda: instance.set("out1", 1.0): "out1 is an output, it cannot be set",
        lambda: instance.call("getReal", [6]): "value reference 6 of a real variable is unknown; there are 6",
        lambda: instance.call("setReal", [99], [0.0]): "value reference 99 of a real variable is unknown",
        lambda: instance.set_derivatives("in1", [1.0] * 10): "derivatives of in1 must be of order 1 to 9, got order 10",
        lambda: instance.set_derivatives("in1", [float("inf")]): "derivative 1 of in1 must be a finite number",
        lambda: instance.set_derivatives("out1", [1.0]): "value reference 5 is no input",
        lambda: instance.get_derivatives(1): "outputs are held between samples and jump there",
        lambda: instance.call("getInteger", [1]): "value reference 1 of an integer variable is unknown; there are 1",
        lambda: instance.call("setInteger", [0], [5]): "counts samples, it cannot be set",
        lambda: instance.step(-1e-3): "step size must be positive",
        lambda: instance.call("doStep", 0.5, 1e-3): "communication point must be the present time",
    }.items():
        with pytest.raises(RefusedError, match="^.*" + sentence.replace(".", "[.]")):
            call()
        instance.time = 0.0
    instance.set_inputs([1.0, 0.0])
    assert instance.get_outputs() == before


def test_failing_sample_is_named_and_can_be_mended(export: Export) -> None:
    """A division by zero stops initialisation, or the step at that sample, with the output's name; better inputs go on from there."""
    make = export(reciprocal())
    with pytest.raises(RefusedError, match="sampling at 0 s: out1 is inf"):
        make("no first sample").start()
    instance = make().start(in1=1.0)
    instance.set_derivatives("in1", [-1.0 / (3 * SAMPLE_TIME)])  # zero at sample 3, up to rounding
    instance.step(2.5 * SAMPLE_TIME)
    instance.set("in1", 0.0)
    with pytest.raises(RefusedError, match=r"sampling at 0[.]003 s: out1 is inf; check inputs and parameters"):
        instance.step(2 * SAMPLE_TIME)
    assert instance.call("getRealStatus", 2) == pytest.approx(3 * SAMPLE_TIME)
    with pytest.raises(RefusedError, match="out1 is inf"):
        instance.get("out1")
    instance.time = 3 * SAMPLE_TIME
    instance.set("in1", 4.0)
    assert instance.get("out1") == 0.25
    instance.step(SAMPLE_TIME)
    assert instance.samples() == 4


def test_termination(export: Export) -> None:
    """Terminated instances show their last outputs and go no further."""
    instance = export(delay())()
    inputs = np.arange(1.0, 11.0)[:, None]
    run(instance, inputs, SAMPLE_TIME)
    instance.call("terminate")
    assert instance.get("out1") == inputs[3, 0]
    with pytest.raises(RefusedError, match="must not be called in the state 'terminated'"):
        instance.step(SAMPLE_TIME)
