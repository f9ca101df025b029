"""An exported block does what its CasADi functions say, at its own instants, whoever steps it and how; rollback, reset and refused calls too."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import Any

import numpy as np
import pytest
from export_support import blocks
from export_support.blocks import SAMPLE_TIME, delay, pd_controller, reciprocal, saturation
from export_support.instance import Instance, RefusedError, run
from export_support.kinds import KINDS
from hypothesis import given, settings
from hypothesis import strategies as st

Export = Callable[..., Any]

ROUNDING = 1e-12
"""Relative to the largest value: the compiler may order a sum in another way than CasADi's virtual machine."""

BLOCKS = [blocks.pd_controller, blocks.fir, blocks.delay, blocks.quantiser, blocks.saturation]


def assert_rounding(found: Any, wanted: Any) -> None:
    """Equal to rounding, relative to the largest value."""
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=ROUNDING * max(1.0, np.abs(wanted).max()))


@pytest.mark.parametrize("make", BLOCKS, ids=lambda make: make.__name__)
def test_exported_block_is_its_functions(export: Export, make: Callable[[], Any]) -> None:
    """Slave and FMU are made from the same equations, so a user may trust either."""
    block = make()
    inputs = np.random.default_rng(1).normal(size=(200, len(block.inputs)))
    found = run(export(block)(), inputs, blocks.SAMPLE_TIME)
    assert_rounding(found, blocks.expected(block, inputs))


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 1.0))
def test_random_linear_systems(linear: Any, seed: int, scale: float) -> None:
    """Any stable or mildly unstable linear controller, its matrices given as parameters."""
    block, instance = linear
    random = np.random.default_rng(seed)
    parameters = scale * random.normal(size=len(block.parameters))
    inputs = random.normal(size=(30, len(block.inputs)))
    instance.call("reset")
    values = {each.name: value for each, value in zip(block.parameters, parameters, strict=True)}
    assert_rounding(
        run(instance, inputs, blocks.SAMPLE_TIME, **values), blocks.expected(block, inputs, list(parameters))
    )


@pytest.fixture
def linear(export: Export) -> Any:
    """A linear system with three states, two inputs and two outputs, and an instance of it."""
    block = blocks.linear_system(3, 2, 2)
    return block, export(block)()


@pytest.mark.parametrize("ratio", [1 / 7, 0.3, 1.0, 2.5, 10.0])
def test_communication_step_changes_nothing(export: Export, ratio: float) -> None:
    """Samples belong to the block, not to the importer: the input is a parabola, given by its derivatives,
    which say what it is at an instant before it is set there."""
    instance = export(blocks.counter())().start()
    instance.set("in1", 0.25)
    instance.set_derivatives("in1", [3.0, -40.0])
    step, count = ratio * blocks.SAMPLE_TIME, round(50 / ratio)
    for n in range(1, count + 1):
        instance.step(step, until=n * step)
        k, u = instance.get_outputs()
        assert k == np.floor(n * ratio * (1 + 1e-12))
        assert u == pytest.approx(0.25 + 3.0 * k * blocks.SAMPLE_TIME - 20.0 * (k * blocks.SAMPLE_TIME) ** 2, abs=1e-15)


def test_inputs_are_held(export: Export) -> None:
    """Without derivatives every sample within a step takes the input of the step's beginning."""
    instance = export(blocks.delay(2))().start()
    instance.set("in1", 3.0)
    instance.step(1.5 * blocks.SAMPLE_TIME)
    instance.set("in1", 4.0)
    assert instance.get("out1") == 0.5
    instance.step(1.5 * blocks.SAMPLE_TIME)  # samples 0 and 1 took 3, sample 2 takes 4, sample 3 is due
    assert instance.get("out1") == 3.0
    instance.step(blocks.SAMPLE_TIME)
    assert instance.get("out1") == 4.0


@pytest.mark.parametrize(("offset", "step"), [(0.5, 0.25), (2.0, 1.0), (0.3, 1.0), (3.7, 10.0), (1.0, 1 / 3)])
def test_offset_shifts_the_instants(export: Export, offset: float, step: float) -> None:
    """The first sample comes an offset after the start, wherever the importer's grid is; until then the outputs are those
    of the initial inputs."""
    instance = export(blocks.counter(offset=offset * blocks.SAMPLE_TIME))().start(in1=7.0)
    assert instance.get_outputs() == [0.0, 7.0]
    instance.set("in1", 8.0)
    for n in range(1, 61):
        instance.step(step * blocks.SAMPLE_TIME, until=n * step * blocks.SAMPLE_TIME)
        begun, completed = np.floor(n * step - offset + 1e-9) + 1, np.ceil(n * step - offset - 1e-9)
        assert instance.get_outputs() == [max(begun - 1, 0.0), 8.0 if completed > 0 else 7.0]


@pytest.mark.parametrize(("start", "step", "ratio", "count"), [(5.0, 0.1, 3, 100), (0.0, 1e-3, 1, 100_000)])
def test_summed_time_loses_no_sample(export: Export, start: float, step: float, ratio: int, count: int) -> None:
    """Instants count from the start time. Importers add up t += h; after a hundred thousand steps that is off by 1e-9 of a
    second, and still no sample is missed or taken twice."""
    instance = export(blocks.counter(sample_time=ratio * step))().start(time=start)
    for n in range(1, count + 1):
        instance.step(step)  # sums
        if n % (count // 100) == 0:
            assert instance.get("out1") == n // ratio
            assert instance.samples() == ceil(n / ratio)


def test_last_word_before_the_step_counts(export: Export) -> None:
    """At an instant the outputs follow the inputs, as often as they are set; the sample is completed by the next step."""
    block = blocks.pd_controller()
    instance = export(block)().start()
    for u in ([1.0, 0.0], [5.0, 2.0], [-1.0, 0.5]):
        instance.set_inputs(u)
        assert_rounding(instance.get_outputs(), blocks.expected(block, np.array([u]))[0])
    assert instance.samples() == 0
    instance.step(blocks.SAMPLE_TIME)
    instance.set_inputs([0.3, 0.1])
    assert instance.samples() == 1
    assert_rounding(instance.get_outputs(), blocks.expected(block, np.array([[-1.0, 0.5], [0.3, 0.1]]))[1])


def test_inputs_that_are_not_set_keep_their_values(export: Export) -> None:
    """One input set at an instant is enough for this sample; without any the outputs are those of the sample before, and the
    block goes on all the same."""
    block = blocks.pd_controller()
    exact = blocks.expected(block, np.array([[1.0, 0.2]] * 6 + [[3.0, 0.2]] * 4))
    instance = export(block)().start(in1=1.0, in2=0.2)
    for k in range(1, 6):
        instance.step(blocks.SAMPLE_TIME, until=k * blocks.SAMPLE_TIME)
        assert_rounding(instance.get_outputs(), exact[k - 1])
    instance.step(blocks.SAMPLE_TIME, until=6 * blocks.SAMPLE_TIME)
    instance.set("in1", 3.0)
    assert_rounding(instance.get_outputs(), exact[6])
    instance.step(blocks.SAMPLE_TIME, until=7 * blocks.SAMPLE_TIME)
    assert_rounding(instance.get_outputs(), exact[6])


def test_inputs_between_instants_wait(export: Export) -> None:
    """Between instants the outputs are held, whatever is set, and at an instant until something is set there: an importer
    that sets its inputs after it has read the outputs stands a step before the instant with them."""
    instance = export(blocks.quantiser())().start(in1=1.0)
    instance.step(0.5 * blocks.SAMPLE_TIME)
    instance.set("in1", 2.0)
    assert instance.get("out1") == 1.0
    instance.step(0.25 * blocks.SAMPLE_TIME)
    assert instance.get("out1") == 1.0
    instance.step(0.25 * blocks.SAMPLE_TIME, until=blocks.SAMPLE_TIME)
    assert instance.get("out1") == 1.0
    instance.set("in1", 3.0)
    assert instance.get("out1") == 3.0


def test_tunable_parameters_act_on_the_next_sample(export: Export) -> None:
    """Gain scheduling: a tunable parameter may change between steps, a fixed one may not."""
    block = blocks.pd_controller()
    instance = export(block)().start(kd=0.0)
    instance.set_inputs([1.0, 0.0])
    assert instance.get("out1") == 12.0
    instance.set("kd", 10.0)
    assert instance.get("out1") == 12.0 + 10.0 * 0.2
    with pytest.raises(RefusedError, match="kp is fixed after initialisation"):
        instance.set("kp", 1.0)


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
