"""Filters against scipy's designs and recursions, and in loops; the shaper for sampled signals has the closed form with split impulses."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
import pytest
from blocks import context, looped, sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import flexfmu
from flexfmu.cosim.control.filters import SecondOrder, biquad, filter_block, high_pass, lead_lag, low_pass, notch
from flexfmu.cosim.control.shapers import JOINT_REFERENCES, shaper_block
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.shapers.designs import design
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator, ShapedTrajectory

H = 1e-3
W = 2.0 * pi * 60.0


def block(sections: list[SecondOrder]) -> SymbolicBlock:
    """The block of a chain of sections."""
    return filter_block(flexfmu.filters.notch(frequency=1.0, sample_time=H), context("filter"), sections)


def bilinear(numerator: list[float], denominator: list[float], w: float) -> tuple[np.ndarray, np.ndarray]:
    """scipy's bilinear transformation with a sampling frequency that is exact at w."""
    return signal.bilinear(numerator, denominator, fs=0.5 * w / np.tan(0.5 * w * H))


DESIGNS: dict[str, tuple[list[SecondOrder], Callable[[], tuple[np.ndarray, np.ndarray]]]] = {
    "notch": (notch(60.0, 0.4, 0.1), lambda: bilinear([1, 0.08 * W, W * W], [1, 0.8 * W, W * W], W)),
    "low-pass 1": (low_pass(60.0, 1), lambda: signal.butter(1, 60.0, fs=1 / H)),
    "low-pass 2": (low_pass(60.0, 2), lambda: signal.butter(2, 60.0, fs=1 / H)),
    "low-pass 5": (low_pass(60.0, 5), lambda: signal.butter(5, 60.0, fs=1 / H)),
    "high-pass 3": (high_pass(60.0, 3), lambda: signal.butter(3, 60.0, "highpass", fs=1 / H)),
    "high-pass 4": (high_pass(60.0, 4), lambda: signal.butter(4, 60.0, "highpass", fs=1 / H)),
    "lead-lag": (lead_lag(30.0, 120.0), lambda: bilinear([0.5 / (30 * pi), 1], [0.5 / (120 * pi), 1], W)),
    "biquad": (biquad([2.0, 30.0], [1.0, 50.0, 900.0]), lambda: signal.bilinear([2.0, 30.0], [1.0, 50.0, 900.0], fs=1 / H)),
}  # fmt: skip


@pytest.mark.parametrize("name", DESIGNS)
def test_filters_are_those_of_scipy(name: str) -> None:
    """A ramp that becomes a sine, from the steady state of the first sample on."""
    sections, design = DESIGNS[name]
    time = H * np.arange(400)
    u = 1.0 + np.where(time < 0.1, 20.0 * time, 2.0 + np.sin(W * time))
    b, a = design()
    expected, _ = signal.lfilter(b, a, u, zi=signal.lfilter_zi(b, a) * u[0])
    np.testing.assert_allclose(sampled(block(sections), u)[:, 0], expected, rtol=0.0, atol=1e-11)


@given(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from(["frequency", "order", "damping", "depth"]))
@settings(max_examples=60)
def test_bad_values_are_told_with_their_key(value: float, key: str) -> None:
    keys = {"kind": "low-pass" if key == "order" else "notch", "frequency": 50.0, "sample_time": H, key: value}
    good = value >= 1.0 and (key != "order" or value in range(1, 9)) and value != float("inf")
    if (key != "order" and 0.0 < value < float("inf")) or (key == "depth" and value == 0.0) or good:
        load_scene("barnard2012-6kg").replace({"filter": [keys]})
        return
    with pytest.raises(SceneError, match=rf"`filter\[0\]\.{key}`"):
        load_scene("barnard2012-6kg").replace({"filter": [keys]})


@pytest.mark.parametrize(("keys", "message"), [
    ({"kind": "notch", "frequency": 50.0, "at": "mode 1"}, "either `frequency` in Hz, or `at`"),
    ({"kind": "notch"}, "either `frequency` in Hz, or `at`"),
    ({"kind": "notch", "at": "mode one"}, "name a frequency as"),
    ({"kind": "biquad", "numerator": [1, 0, 0], "denominator": [1, 1]}, "must not exceed"),
    ({"kind": "biquad", "numerator": [1], "denominator": [0, 0]}, "isn't 0"),
])  # fmt: skip
def test_contradictions_are_told(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load_scene("barnard2012-6kg").replace({"filter": [keys]})


def scene(**filters: Any) -> Scene:
    """The paper's robot with few modes and a PD controller, and a filter."""
    pd = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}
    return looped(pd).replace({"filter": [filters] if filters else []})


def test_frequencies_by_name_are_those_of_the_robot() -> None:
    modes = flexfmu.modes(scene(), poses=3)[-1].frequencies
    by_name, by_number = (
        flexfmu.run(scene(kind="notch", **keys)).metrics["peak_tracking_error_1"]
        for keys in ({"at": "mode 2"}, {"frequency": modes[1]})
    )
    assert float(by_name) == pytest.approx(float(by_number), rel=1e-9)
    with pytest.raises(InputError, match=r"has no `resonance 9`: resonances at the end in Hz"):
        flexfmu.run(scene(kind="notch", at="resonance 9"))
    with pytest.raises(InputError, match=r"a filter at 700 Hz needs a sample time below 0\.0007143 s, got 0\.001 s"):
        flexfmu.run(scene(kind="low-pass", frequency=700.0))


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
def test_filters_stand_behind_encoders_and_before_lags() -> None:
    """The torque is filtered, then late; the position is rounded, then filtered."""
    robot = scene().replace(
        {
            "imperfection": [{"kind": "encoder", "counts_per_turn": 1e4}, {"kind": "lag", "time_constant": 1e-3}],
            "filter": [
                {"kind": "low-pass", "frequency": 300.0, "name": "smooth"},
                {"kind": "low-pass", "frequency": 300.0, "signal": "velocity", "name": "speed"},
            ],
        }
    )
    run = flexfmu.run(robot)
    ends = {delay.connection for delay in run.delays}
    assert "pd.joint1.torque -> smooth.joint1.torque.input" in ends
    assert "smooth.joint1.torque -> lag.joint1.torque.input" in ends
    assert "encoder.joint1.velocity -> speed.joint1.velocity.input" in ends
    assert "speed.joint1.velocity -> pd.joint1.velocity" in ends


@pytest.mark.parametrize(
    "sections", [low_pass(60.0, 1), low_pass(60.0, 3), high_pass(60.0, 1), lead_lag(30.0, 120.0), biquad([1.0], [2.0])]
)
def test_sections_of_first_order_stay_of_first_order(sections: list[SecondOrder]) -> None:
    """No pole at z = -1, which a zero would cancel but for rounding: all poles are inside the unit circle."""
    for each in sections:
        _, a = each.discrete(H)
        assert abs(np.roots([1.0, *a])).max() < 0.99


def test_filters_of_odd_order_keep_margins_finite() -> None:
    """A filter far above the crossover changes the margins little; its poles aren't those of the loop's instability."""
    plain = scene_margins(scene(), poses=1).worst.gain_margin
    for filters in (
        {"kind": "low-pass", "frequency": 450.0, "order": 1},
        {"kind": "lead-lag", "zero": 400.0, "pole": 410.0},
    ):
        found = scene_margins(scene(**filters), poses=1).worst.gain_margin
        assert 0.5 * plain < found < 1.1 * plain


@pytest.mark.parametrize(("numerator", "denominator"), [([1.0, 0.0, 1.0], [1.0, 1.0]), ([1.0, 0.0], [2.0])])
def test_an_improper_filter_is_refused(numerator: list[float], denominator: list[float]) -> None:
    with pytest.raises(InputError, match="isn't proper"):
        block(biquad(numerator, denominator))


MODE = Oscillator(58.0, 0.02)


@pytest.fixture(scope="module")
def motion() -> MotionPlan:
    """The paper's motion with jumps of the acceleration."""
    return plan(load_scene("barnard2012-6kg").replace({"trajectory.profile": {"kind": "bang-bang"}}))


@pytest.mark.parametrize("sample_time", [1e-3, 2.5e-4, 0.73e-3])
@pytest.mark.parametrize("name", ["um-zv", "zv", "zvdd", "3-hump-ei"])
def test_sampled_shaper_is_the_closed_form(motion: MotionPlan, name: str, sample_time: float) -> None:
    """Position, velocity and acceleration of both joints are Σ w_i q(t_k - i h) to 1e-12, from rest to rest."""
    sequence = design(name, [MODE])
    time = sample_time * np.arange(int((motion.duration + sequence.duration) / sample_time) + 10)
    inputs = motion.joints.evaluate(time, 2).swapaxes(0, 1).reshape(len(time), 6)
    found = sampled(shaper_block(sequence, sample_time), inputs)
    expected = ShapedTrajectory(motion.joints, sequence.split(sample_time)).evaluate(time, 2)
    scale = np.max(np.abs(expected), axis=(1, 2))
    for order in range(3):
        # the shaped trajectory is exact at breakpoints, where rounding decides on which side of a jump a sample lies
        clear = np.min(np.abs(time[:, None] - _jumps(motion, sequence, sample_time)), axis=1) > 1e-9
        rows = clear if order == 2 else slice(None)
        difference = found[rows, 2 * order : 2 * order + 2] - expected[order][rows]
        np.testing.assert_allclose(difference / scale[order], 0.0, atol=1e-12)


def _jumps(motion: MotionPlan, sequence: ImpulseSequence, sample_time: float) -> np.ndarray:
    points = [[delay + point for point in motion.joints.breakpoints] for delay in sequence.split(sample_time).times]
    return np.ravel(points)


def test_standstill_stays(motion: MotionPlan) -> None:
    """A machine that rests anywhere is left there from the first sample on: nothing starts from zero."""
    block = shaper_block(design("zvd", [MODE]), 1e-3)
    pose = np.array([1.97, -0.1, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(sampled(block, np.tile(pose, (60, 1))), np.tile(pose, (60, 1)), rtol=1e-15)


def test_variables_and_feedthrough() -> None:
    """Outputs are named after the inputs and depend directly on their own input alone."""
    block = shaper_block(design("ei", [MODE]), 1e-3, offset=5e-4, name="zv1")
    assert [variable.name for variable in block.inputs] == list(JOINT_REFERENCES)
    assert [variable.unit for variable in block.outputs] == list(JOINT_REFERENCES.values())
    assert block.feedthrough == {f"shaped.{name}": (name,) for name in JOINT_REFERENCES}
    assert (block.sample_time, block.offset, block.name) == (1e-3, 5e-4, "zv1")


def test_bad_sample_times_are_refused() -> None:
    """A sample time of nothing, or one that needs an endless line, is named with what would do."""
    with pytest.raises(InputError, match="sample time must be positive, got 0"):
        shaper_block(UNSHAPED, 0.0)
    with pytest.raises(InputError, match=r"sample time of 1e-07 s makes a line of .* choose a larger sample time"):
        shaper_block(design("zv", [MODE]), 1e-7)
