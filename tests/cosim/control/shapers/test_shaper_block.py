"""The shaper for sampled signals: the same numbers as the closed form with split impulses."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import sampled

from flexfmu.cosim.control.shapers import JOINT_REFERENCES, shaper_block
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.shapers.designs import design
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator, ShapedTrajectory

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
