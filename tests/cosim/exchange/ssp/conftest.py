"""FMUs that SSP files of the tests hold, and exported scenes."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from ssp_support.packages import SSD, package

from flexfmu.cosim.control.controllers.from_control import control_block
from flexfmu.cosim.exchange.ssp.export import export_ssp
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


@pytest.fixture(scope="session")
def make_decay(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., bytes]:
    """Makes a plain FMU of another tool's kind, x' = rate (u - x), its description changed: make_decay(("m", "mm"))."""
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    foreign = _module(Path(__file__).parents[2] / "engine" / "conftest.py")
    folder = tmp_path_factory.mktemp("foreign")
    library = foreign.compiled(folder, compiler)
    description = (foreign.FOREIGN / "modelDescription.xml").read_text()

    def make(*changes: tuple[str, str]) -> bytes:
        text = description
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        content: bytes = foreign.pack(folder / "decay.fmu", text, library).read_bytes()
        return content

    return make


def _module(path: Path) -> Any:
    """A module by its path."""
    spec = spec_from_file_location("foreign", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def make_ssp(make_decay: Callable[..., bytes], tmp_path: Path) -> Callable[..., Path]:
    """Makes an SSP file of two foreign FMUs: make_ssp(ssd=SSD, **further files by name)."""

    def make(ssd: str | bytes = SSD, files: dict[str, bytes | str] | None = None) -> Path:
        content = {"SystemStructure.ssd": ssd, "resources/decay.fmu": make_decay(), **(files or {})}
        return package(tmp_path / "decays.ssp", content)

    return make


PD = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}


@pytest.fixture(scope="session")
def motion_scene() -> Scene:
    """The paper's robot, driven by its motion."""
    return load_scene("barnard2012-6kg").replace({"name": "motion", "trajectory.dwell": 0.0})


@pytest.fixture(scope="session")
def controlled_scene() -> Scene:
    """The same, driven by torques: PD and feedforward, a sampled shaper, an encoder, an amplifier, a wrong payload."""
    return load_scene("barnard2012-6kg").replace(
        {
            "name": "controlled",
            "cosimulation.drive": "torque",
            "effects.motor_inertia": 0.1,
            "trajectory.dwell": 0.0,
            "controller": [PD, {"kind": "feedforward", "sample_time": 1e-3}],
            "shaper": [
                {"kind": "zv", "modes": [{"frequency": 58.0, "ratio": 0.1}], "apply": "sampled", "sample_time": 1e-3}
            ],
            "imperfection": [
                {"kind": "encoder", "counts_per_turn": 1e6, "window": 1},
                {"kind": "lag", "time_constant": 1e-4, "sample_time": 1e-4},
                {"kind": "payload-error", "relative": 0.1},
            ],
        }
    )


DAMPING_IN_PYTHON = """
import numpy as np
import flexfmu

ends = {
    "inputs": ["joint1.velocity", "joint2.velocity"],
    "outputs": ["joint1.feedforward", "joint2.feedforward"],
}


@flexfmu.controller(sample_time=1e-3, state=[0.0, 0.0], symbolic=True, **ends)
def damping(measurement, state, *, gain=2.0):
    state = 0.5 * state - 0.5 * gain * measurement
    return np.tanh(state), state
"""

DAMPING_IN_C = """
void damping(double t, const double *u, const double *p, const double *x, double *y, double *next_x) {
  (void)t;
  for (int j = 0; j < 2; ++j) {
    next_x[j] = 0.8 * x[j] + p[0] * u[j];
    y[j] = -x[j];
  }
}
"""

OBSERVER = {"kind": "disturbance-observer", "time_constant": 0.05, "inertia": 0.15, "sample_time": 1e-3, "offset": 5e-5}


@pytest.fixture(scope="session")
def drive_scene(controlled_scene: Scene) -> Scene:
    """The cascade of a drive at three rates, with an observer; each samples at other instants than those that feed it.

    A force, a torque and a payload disturb it.
    """
    cascade = {
        "kind": "cascade",
        "position": {"proportional": 60.0, "velocity_limit": 15.0, "offset": 5e-5},
        "velocity": {"proportional": 120.0, "integral": 6e3, "sample_time": 5e-4, "offset": 1.5e-4},
        "current": {"time_constant": 2e-4, "sample_time": 1e-4},
        "torque_limit": 90.0,
        "sample_time": 1e-3,
    }
    short = {"trajectory.width": 0.1, "trajectory.duration": 0.2}
    disturbances = [
        {"kind": "pulse", "signal": "force.x", "amplitude": 20.0, "start": 0.05, "duration": 0.03},
        {"kind": "sine", "signal": "joint1.disturbance", "amplitude": 2.0, "frequency": 20.0, "sample_time": 1e-3},
        {"kind": "payload", "mass": 1.0, "picked_up": 0.1},
    ]
    changes = {"name": "drive", "controller": [cascade, OBSERVER], "shaper": [], "imperfection": [], **short}
    changes["disturbance"] = disturbances
    return controlled_scene.replace(changes)


@pytest.fixture(scope="session")
def drive_ssp(drive_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive as an SSP file."""
    return _exported(drive_scene, tmp_path_factory)


@pytest.fixture(scope="session")
def summed_scene(drive_scene: Scene) -> Scene:
    """The drive with feedforwards that add up."""
    gravity = {"kind": "gravity-feedforward", "sample_time": 1e-3}
    friction = {"kind": "friction-compensation", "viscous": 1.0, "sample_time": 5e-4}
    cascade = drive_scene.controller[0].model_dump(exclude_none=True)
    return drive_scene.replace({"name": "summed", "controller": [cascade, gravity, friction, OBSERVER]})


@pytest.fixture(scope="session")
def summed_ssp(summed_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive with feedforwards that add up, as an SSP file."""
    return _exported(summed_scene, tmp_path_factory)


LINEAR = control.ss([[0.9, 0.0], [0.0, 0.9]], 0.1 * np.eye(2), -np.eye(2), np.zeros((2, 2)), 1e-3)
VELOCITIES, FEEDFORWARDS = ([f"joint{i}.{what}" for i in (1, 2)] for what in ("velocity", "feedforward"))
ENDS: dict[str, Any] = {"inputs": VELOCITIES, "outputs": FEEDFORWARDS}


@pytest.fixture(scope="session")
def furnished_scene(drive_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A PD whose gains follow the pose, with feedforwards of the flexible robot, in Python, in C and as an FMU of a python-control
    system; filters, dead zone, backlash, a known delay; a force, band noise, and a payload that is dropped."""
    folder = tmp_path_factory.mktemp("furnished")
    fmu = build_fmu(control_block(LINEAR, name="linear", **ENDS), folder / "linear.fmu").path
    (folder / "damping.py").write_text(DAMPING_IN_PYTHON, encoding="utf-8")
    (folder / "damping.c").write_text(DAMPING_IN_C, encoding="utf-8")
    time = {"sample_time": 1e-3}
    schedule = {"over": "joint1.position", "at": [2.5, 3.0, 3.5], "proportional": [0.8, 1.0, 1.2]}
    in_c = {"kind": "c-function", "source": str(folder / "damping.c"), "parameters": {"gain": 0.1}, **ENDS, **time}
    changes: dict[str, Any] = {
        "name": "furnished",
        "controller": [
            {**PD, "schedule": schedule},
            {"kind": "feedforward", "robot": "flexible", **time},
            {"kind": "python", "source": "damping:damping", "folder": str(folder)},
            {**in_c, "name": "c_damping", "function": "damping", "states": [0.0, 0.0]},
            {"kind": "fmu", "name": "linear", "path": str(fmu)},
        ],
        "filter": [
            {"kind": "notch", "frequency": 160.0},
            {"kind": "lead-lag", "zero": 60.0, "pole": 120.0},
            {"kind": "low-pass", "frequency": 300.0, "order": 3, "signal": "velocity"},
            {"kind": "low-pass", "frequency": 60.0, "signal": "reference"},
        ],
        "imperfection": [
            {"kind": "dead-zone", "half_width": 0.1},
            {"kind": "backlash", "signal": "position", "gap": 1e-5},
            {"kind": "delay", "signal": "position", "time": 1e-3, "known": True},
        ],
        "disturbance": [
            {"kind": "step", "signal": "force.x", "amplitude": 5.0, "start": 0.1503},
            {
                "kind": "noise",
                "signal": "joint1.disturbance",
                "standard_deviation": 2.0,
                "band": [5.0, 50.0],
                "components": 8,
                **time,
            },
            {"kind": "payload", "dropped": 0.12, "mass": 1.0},
        ],
    }
    return drive_scene.replace(changes)


@pytest.fixture(scope="session")
def furnished_ssp(furnished_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of these as an SSP file."""
    return _exported(furnished_scene, tmp_path_factory)


@pytest.fixture(scope="session")
def staggered_ssp(controlled_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The controlled scene as an SSP file, each block sampling after those that feed it."""
    sections = controlled_scene.model_dump(exclude_none=True)
    (pd, feedforward), (encoder, lag, payload) = sections["controller"], sections["imperfection"]
    changes = {
        "name": "staggered",
        "controller": [pd | {"offset": 1e-4}, feedforward | {"offset": 5e-5}],
        "imperfection": [encoder, lag | {"offset": 5e-5}, payload],
    }
    return _exported(controlled_scene.replace(changes), tmp_path_factory)


@pytest.fixture(scope="session")
def motion_ssp(motion_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The motion-driven scene as an SSP file."""
    return _exported(motion_scene, tmp_path_factory)


@pytest.fixture(scope="session")
def controlled_ssp(controlled_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The controlled scene as an SSP file."""
    return _exported(controlled_scene, tmp_path_factory)


def _exported(scene: Scene, folders: pytest.TempPathFactory) -> Path:
    """A scene as an SSP file."""
    return export_ssp(scene, folders.mktemp("exported") / f"{scene.name}.ssp")
