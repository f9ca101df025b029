"""Candidates with references for the flexible robot: on the given path, in the given time, for the band of payloads."""

from __future__ import annotations

import pytest

from flexfmu.cosim.choices.plans.planner import plan_scene
from flexfmu.model.reference_design.joint_spline import JointSpline
from flexfmu.model.reference_design.robust_correction import Correction
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


@pytest.mark.slow
def test_the_given_path_is_kept_over_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 0.1 mm and the given torques, already before the correction, which has its own tests."""

    def uncorrected(scene: Scene, variants: object, motors: JointSpline, *others: object) -> Correction:
        return Correction(motors, 0.0, 0.0)

    monkeypatch.setattr("flexfmu.cosim.choices.plans.flexible.corrected", uncorrected)
    few = {"effects.proximal_bending": 1, "effects.distal_axial": 0}
    found = plan_scene(load_scene("barnard2012-6kg").replace(few), methods=["flexible"])
    assert not found.failures
    (assessed,) = found.assessed
    assert assessed.time == pytest.approx(found.given.time)
    assert found.given.residual > 1e-5
    assert assessed.residual < 0.5 * found.given.residual
    assert assessed.off_path < 1e-4
    assert assessed.torque_ratio < 1.0
