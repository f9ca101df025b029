"""Dead zone, backlash and known delays: closed forms, and what loops make of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

H = 1e-3


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
