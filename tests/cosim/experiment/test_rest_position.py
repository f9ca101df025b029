"""Where the end effector rests after a run, by the FMU's own statics against the equations in CasADi."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.experiment.scene_run import rest_position
from flexfmu.model.statics import static_equilibrium

SHORT: dict[str, Any] = {"trajectory.duration": 0.2, "trajectory.dwell": 0.02, "cosimulation.step": 2e-3}
TORQUES: dict[str, Any] = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.05}


@pytest.mark.parametrize("changes", [{}, TORQUES], ids=["motion", "torques"])
@pytest.mark.parametrize("parameters", [{}, {"payload.mass": 2.0}, {"proximal.length": 0.241}], ids=str)
def test_the_fmu_rests_where_the_equations_do(changes: dict[str, Any], parameters: dict[str, float]) -> None:
    """Residual vibration is measured from there: tenths of micrometres in a sag of tens."""
    run = flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace(SHORT | changes), parameters=parameters)
    joints = run.plan.joints.evaluate(np.array([run.plan.duration]), 0, side="left")[0, 0]
    np.testing.assert_allclose(rest_position(run), static_equilibrium(run.robot, joints).position, rtol=0, atol=1e-15)


def test_metrics_of_a_run_load_no_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model in CasADi takes forty times as long as the run."""
    run = flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace(SHORT))
    monkeypatch.setitem(sys.modules, "flexfmu.model.statics", None)
    assert flexfmu.measure_run(run)["residual_vibration_amplitude"].value is not None
