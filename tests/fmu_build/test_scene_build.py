"""The FMU of a scene: what determines it, and how long it takes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import fmpy
import pytest

from flexfmu.cosim.experiment.scene_build import build_scene, scene_key
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

PATH_CHANGES: dict[str, Any] = {
    "trajectory.lift": (0.1, -1.0),
    "trajectory.height": 0.030,
    "trajectory.width": 0.300,
    "trajectory.blend": {"kind": "polar", "height": 0.02, "width": 0.02},
    "trajectory.profile": {"kind": "bang-bang"},
    "trajectory.duration": 0.5,
    "trajectory.dwell": 0.1,
    "cosimulation.step": 1e-3,
    "cosimulation.tolerance": 1e-4,
    "cosimulation.settling_band": 1e-6,
}
"""Changes of the motion and of the way it is run."""


@pytest.fixture
def scene() -> Scene:
    """The paper's scene."""
    return load_scene("barnard2012-6kg")


@pytest.mark.slow
def test_path_does_not_matter(scene: Scene) -> None:
    """All motions of a robot share one model: what the key leaves out has no influence on the generated sources."""
    changed = scene.replace(PATH_CHANGES)
    assert scene_key(changed) == scene_key(scene)
    first, second = (generate_sources(build_model(each), DefaultExperiment()) for each in (scene, changed))
    assert first == second


def test_all_else_matters(scene: Scene) -> None:
    """Whatever the model depends on is in the key."""
    changes: dict[str, Any] = {
        "name": "other",
        "mechanism.base_half_distance": 0.11,
        "mechanism.proximal.diameter": 0.04,
        "mechanism.material.density": 7800.0,
        "payload.mass": 0.1,
        "effects.gravity": (0.0, 0.0),
        "effects.proximal_bending": 2,
        "effects.damping": {"kind": "stiffness", "time": 1e-4},
        "trajectory.start": (-0.17, 0.32),
        "cosimulation.initial": "undeformed",
    }
    other_mode = {"mechanism.working_mode": "elbows-in", "mechanism.assembly_mode": "right"}
    keys = [scene_key(scene.replace(each)) for each in ({}, other_mode, *({key: changes[key]} for key in changes))]
    assert len(set(keys)) == len(keys)


def test_builds_cost_what_is_new(scene: Scene, cache_folder: Path, object_folder: Path) -> None:
    """The FMU proposes the scene's step and tolerance and ends with its dwell; built again, what takes longest to load isn't loaded.
    Object files are kept: a scene with another payload compiles its table of constants and nothing else."""
    proposed = fmpy.read_model_description(str(build_scene(scene).path)).defaultExperiment
    assert (proposed.stopTime, float(proposed.stepSize)) == ("0.68", scene.cosimulation.step)
    assert float(proposed.tolerance) == scene.cosimulation.tolerance
    script = (
        "import sys; from flexfmu.model.scene.file import load_scene\n"
        "from flexfmu.cosim.experiment.scene_build import build_scene\n"
        "print(build_scene(load_scene('barnard2012-6kg')).cached, {'casadi', 'jinja2', 'fmpy'} & set(sys.modules))"
    )
    outcome = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=os.environ, check=True)
    assert outcome.stdout.strip() == "True set()"
    # from here on with a copy, into which no other process compiles
    own = cache_folder / "objects"
    own.unlink()
    shutil.copytree(object_folder, own)
    before = set(own.glob("*.o"))
    assert not build_scene(scene.replace({"payload.mass": 5.4321})).cached
    assert len(set(own.glob("*.o")) - before) == 1
