"""Dead zone, backlash and known delays: closed forms, and what loops make of them."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import looped

import flexfmu
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.model.scene.errors import SceneError

H = 1e-3


PID = {"kind": "pid", "proportional": 4e3, "integral": 1e4, "derivative": 40.0, "sample_time": H}


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
def test_references_of_a_known_delay_are_as_late_as_the_measurement() -> None:
    run = flexfmu.run(looped(PID, {"kind": "delay", "signal": "position", "time": 2e-3, "known": True}))
    time, joints = run.recording.time, run.plan.joints
    at_samples = np.flatnonzero(np.abs(time / H - np.round(time / H)) < 1e-9)[20:400]
    found = run.recording["delay.joint1.reference.position"].values[at_samples]
    # the right limit of an instant that is there twice
    last = np.append(np.diff(time[at_samples]) > 0.0, True)
    expected = joints.evaluate(time[at_samples] - 2e-3, 0)[0, :, 0]
    np.testing.assert_allclose(found[last], expected[last], atol=1e-12)


def test_a_known_delay_is_one_of_a_measurement() -> None:
    with pytest.raises(SceneError, match='a `known` delay is one of `signal = "position"` or "velocity", got "torque"'):
        looped(PID, {"kind": "delay", "time": 2e-3, "known": True})


def test_margins_are_those_of_large_signals() -> None:
    plain = scene_margins(looped(PID), poses=1).worst.gain_margin
    rough = [{"kind": "dead-zone", "half_width": 0.5}, {"kind": "backlash", "gap": 1e-4}]
    assert scene_margins(looped(PID, *rough), poses=1).worst.gain_margin == pytest.approx(plain, rel=1e-6)
