"""An exported block does what its CasADi functions say, at its own instants, whoever steps it and how."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import Any

import numpy as np
import pytest
from export_support import blocks
from export_support.instance import RefusedError, run
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
