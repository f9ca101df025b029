"""FMUs that SSP files of the tests hold, and exported scenes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
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


@pytest.fixture
def make_ssp(make_decay: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """Makes an SSP file of two foreign FMUs: make_ssp(ssd=SSD, **further files by name)."""

    def make(ssd: str = SSD, files: dict[str, str | Path] | None = None) -> Path:
        content = {"SystemStructure.ssd": ssd, "resources/decay.fmu": make_decay(), **(files or {})}
        return package(tmp_path / "decays.ssp", content)

    return make


PD = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}
FEEDFORWARD = {"kind": "feedforward", "sample_time": 1e-3}
ENCODER = {"kind": "encoder", "counts_per_turn": 1e6, "window": 1}
LAG = {"kind": "lag", "time_constant": 1e-4, "sample_time": 1e-4}
PAYLOAD = {"kind": "payload-error", "relative": 0.1}
OBSERVER = {"kind": "disturbance-observer", "time_constant": 0.05, "inertia": 0.15, "sample_time": 1e-3, "offset": 5e-5}
CASCADE = {
    "kind": "cascade",
    "position": {"proportional": 60.0, "velocity_limit": 15.0, "offset": 5e-5},
    "velocity": {"proportional": 120.0, "integral": 6e3, "sample_time": 5e-4, "offset": 1.5e-4},
    "current": {"time_constant": 2e-4, "sample_time": 1e-4},
    "torque_limit": 90.0,
    "sample_time": 1e-3,
}

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

MOTION: dict[str, Any] = {"trajectory.dwell": 0.0}
CONTROLLED = MOTION | {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [PD, FEEDFORWARD],
    "shaper": [{"kind": "zv", "modes": [{"frequency": 58.0, "ratio": 0.1}], "apply": "sampled", "sample_time": 1e-3}],
    "imperfection": [ENCODER, LAG, PAYLOAD],
}
DRIVE = CONTROLLED | {
    "trajectory.width": 0.1,
    "trajectory.duration": 0.2,
    "controller": [CASCADE, OBSERVER],
    "shaper": [],
    "imperfection": [],
    "disturbance": [
        {"kind": "pulse", "signal": "force.x", "amplitude": 20.0, "start": 0.05, "duration": 0.03},
        {"kind": "sine", "signal": "joint1.disturbance", "amplitude": 2.0, "frequency": 20.0, "sample_time": 1e-3},
        {"kind": "payload", "mass": 1.0, "picked_up": 0.1},
    ],
}


def furnished(folder: Path) -> dict[str, Any]:
    """The drive's robot with everything else that a scene can have."""
    linear = control.ss([[0.9, 0.0], [0.0, 0.9]], 0.1 * np.eye(2), -np.eye(2), np.zeros((2, 2)), 1e-3)
    velocities, feedforwards = ([f"joint{i}.{what}" for i in (1, 2)] for what in ("velocity", "feedforward"))
    ends: dict[str, Any] = {"inputs": velocities, "outputs": feedforwards}
    fmu = build_fmu(control_block(linear, name="linear", **ends), folder / "linear.fmu").path
    (folder / "damping.py").write_text(DAMPING_IN_PYTHON, encoding="utf-8")
    (folder / "damping.c").write_text(DAMPING_IN_C, encoding="utf-8")
    time = {"sample_time": 1e-3}
    schedule = {"over": "joint1.position", "at": [2.5, 3.0, 3.5], "proportional": [0.8, 1.0, 1.2]}
    in_c = {"kind": "c-function", "source": str(folder / "damping.c"), "parameters": {"gain": 0.1}, **ends, **time}
    noise = {"kind": "noise", "signal": "joint1.disturbance", "standard_deviation": 2.0, "band": [5.0, 50.0]}
    return DRIVE | {
        "controller": [
            {**PD, "schedule": schedule},
            {"kind": "feedforward", "robot": "flexible", **time},
            {"kind": "gravity-feedforward", **time},
            {"kind": "friction-compensation", "viscous": 1.0, "sample_time": 5e-4},
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
            noise | {"components": 8, **time},
            {"kind": "payload", "dropped": 0.12, "mass": 1.0},
        ],
    }


SCENES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "motion": lambda folder: MOTION,
    "controlled": lambda folder: CONTROLLED,
    # each block samples after those that feed it
    "staggered": lambda folder: (
        CONTROLLED
        | {
            "controller": [PD | {"offset": 1e-4}, FEEDFORWARD | {"offset": 5e-5}],
            "imperfection": [ENCODER, LAG | {"offset": 5e-5}, PAYLOAD],
        }
    ),
    # a cascade at three rates, with an observer; each samples at other instants than those that feed it
    "drive": lambda folder: DRIVE,
    "furnished": furnished,
}
"""The paper's robot, driven by its motion, and in loops with all that a scene can have."""


@pytest.fixture(scope="session")
def scene_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Scene]:
    """Gives one of `SCENES`."""

    @cache
    def scene(name: str) -> Scene:
        changes = SCENES[name](tmp_path_factory.mktemp(name))
        return load_scene("barnard2012-6kg").replace(changes | {"name": name})

    return scene


@pytest.fixture(scope="session")
def ssp_of(scene_of: Callable[[str], Scene], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives one of `SCENES` as an SSP file."""
    return cache(lambda name: export_ssp(scene_of(name), tmp_path_factory.mktemp("exported") / f"{name}.ssp"))
