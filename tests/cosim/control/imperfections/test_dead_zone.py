"""Dead zone, backlash and known delays: closed forms, and what loops make of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blocks import backlash, dead_zone, sampled

import flexfmu
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

H = 1e-3


def test_a_dead_zone_takes_small_values_and_shortens_large_ones() -> None:
    u = np.linspace(-3.0, 3.0, 101)
    expected = np.sign(u) * np.maximum(np.abs(u) - 0.7, 0.0)
    np.testing.assert_allclose(sampled(dead_zone(0.7, sample_time=H), u)[:, 0], expected, atol=1e-15)


def test_backlash_is_half_a_gap_behind_and_stands_still_at_reversals() -> None:
    up, down = np.linspace(0.0, 2.0, 201), np.linspace(2.0, 0.0, 201)
    found = sampled(backlash(0.5, sample_time=H), np.concatenate([up, down]))[:, 0]
    # from the middle of the gap, half a gap behind, still for a whole gap, half a gap ahead
    np.testing.assert_allclose(found[:201], np.maximum(up - 0.25, 0.0), atol=1e-15)
    np.testing.assert_allclose(found[201:], np.minimum(down + 0.25, 1.75), atol=1e-15)


def test_no_backlash_and_no_dead_zone_pass_the_signal() -> None:
    u = np.random.default_rng(0).normal(size=50)
    for block in (backlash(0.0, sample_time=H), dead_zone(0.0, sample_time=H)):
        np.testing.assert_array_equal(sampled(block, u)[:, 0], u)


def scene(*imperfections: dict[str, Any]) -> Scene:
    """The paper's robot with few modes and a PD controller."""
    return load_scene("barnard2012-6kg").replace(
        {
            "cosimulation.drive": "torque",
            "effects.motor_inertia": 0.1,
            "effects.proximal_bending": 1,
            "effects.distal_axial": 1,
            "trajectory.dwell": 0.1,
            "controller": [{"kind": "pid", "proportional": 4e3, "integral": 1e4, "derivative": 40.0, "sample_time": H}],
            "imperfection": list(imperfections),
        }
    )


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
def test_references_of_a_known_delay_are_as_late_as_the_measurement() -> None:
    run = flexfmu.run(scene({"kind": "delay", "signal": "position", "time": 2e-3, "known": True}))
    time, joints = run.recording.time, run.plan.joints
    at_samples = np.flatnonzero(np.abs(time / H - np.round(time / H)) < 1e-9)[20:400]
    found = run.recording["delay.joint1.reference.position"].values[at_samples]
    # the right limit of an instant that is there twice
    last = np.append(np.diff(time[at_samples]) > 0.0, True)
    expected = joints.evaluate(time[at_samples] - 2e-3, 0)[0, :, 0]
    np.testing.assert_allclose(found[last], expected[last], atol=1e-12)


def test_a_known_delay_is_one_of_a_measurement() -> None:
    with pytest.raises(SceneError, match='a `known` delay is one of `signal = "position"` or "velocity", got "torque"'):
        scene({"kind": "delay", "time": 2e-3, "known": True})


def test_margins_are_those_of_large_signals() -> None:
    plain = scene_margins(scene(), poses=1).worst.gain_margin
    rough = [{"kind": "dead-zone", "half_width": 0.5}, {"kind": "backlash", "gap": 1e-4}]
    assert scene_margins(scene(*rough), poses=1).worst.gain_margin == pytest.approx(plain, rel=1e-6)
