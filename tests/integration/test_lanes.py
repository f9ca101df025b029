"""Runs whose stages are evaluated side by side against the same runs stage by stage, to the last bit."""

from __future__ import annotations

import platform
import shutil
import sys
import zipfile
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.fmu_build.codegen import LANES_FILE

COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
HAS_LANES = sys.platform == "linux" and platform.machine() == "x86_64"

SHORT: dict[str, Any] = {"trajectory.duration": 0.2, "trajectory.dwell": 0.05, "cosimulation.step": 1e-3}
SCENES: dict[str, dict[str, Any]] = {
    "radau": {"cosimulation.tolerance": 1e-5},
    "gauss4": {"cosimulation.tolerance": 1e-8},
    "gauss2": {"cosimulation.integrator": "gauss2"},
    "odd count": {"effects.distal_bending": 1, "effects.proximal_axial": 2, "effects.gravity": [0.0, 0.0]},
    "torques": {"cosimulation.drive": "torque", "effects.motor_inertia": 0.05},
}


@pytest.mark.skipif(not HAS_LANES or COMPILER is None, reason="the reference is linux64: lanes need its registers")
@pytest.mark.parametrize("changes", SCENES.values(), ids=SCENES)
def test_lanes_give_the_same_bits(changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers that depend on the processor's registers couldn't be compared between machines."""
    scene = flexfmu.load_scene("barnard2012-6kg").replace(SHORT | changes)
    with_lanes = flexfmu.run(scene)
    assert f"sources/{LANES_FILE}" in zipfile.ZipFile(with_lanes.fmu_path).namelist()
    monkeypatch.setenv("CC", f"{COMPILER} -DFLEX_PLAIN")
    plain = flexfmu.run(scene)

    assert plain.fmu_path != with_lanes.fmu_path
    assert plain.health.statistics == with_lanes.health.statistics
    for name in plain.recording.columns:
        np.testing.assert_array_equal(plain.recording[name].values, with_lanes.recording[name].values, err_msg=name)


def test_equations_that_branch_have_no_lanes() -> None:
    """Friction chooses between formulas: a processor that follows one lane would give the others wrong numbers."""
    scene = flexfmu.load_scene("barnard2012-6kg").replace(
        SHORT
        | {
            "cosimulation.drive": "torque",
            "effects.motor_inertia": 0.05,
            "effects.joint_friction": {"kind": "stiction", "coulomb": 1.0, "breakaway": 1.5, "stribeck_velocity": 0.01},
        }
    )
    assert f"sources/{LANES_FILE}" not in zipfile.ZipFile(flexfmu.build(scene)).namelist()
