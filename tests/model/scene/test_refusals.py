"""What scene files are refused for, all sections alike: one line with key, value, unit and remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene

Changes = Mapping[str, Any]

PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
PID = PD | {"kind": "pid", "integral": 1.0}
MOTOR = {"continuous_torque": 1.0, "peak_torque": 3.0, "maximum_speed": 300.0}
AUTO = {
    "gravity": [0.0, -9.81],
    "select": "auto",
    "tolerance": 0.01,
    "of": ["peak_position_error", "residual_vibration_amplitude"],
}


def blend(**keys: Any) -> Changes:
    """The scene with values of its blend."""
    return {f"trajectory.blend.{key}": value for key, value in keys.items()}


def profile(kind: str | None, **keys: Any) -> Changes:
    """The scene with a profile."""
    return {"trajectory.profile": keys if kind is None else keys | {"kind": kind}}


def damping(**keys: Any) -> Changes:
    """The scene with a damping."""
    return {"effects.damping": keys}


def auto(**keys: Any) -> Changes:
    """The scene whose effects are to be chosen, with other keys of the choice, or without those that are None."""
    return {"effects": {key: value for key, value in (AUTO | keys).items() if value is not None}}


def friction(**keys: Any) -> Changes:
    """The scene with friction that sticks."""
    return {"effects.joint_friction": {"kind": "stiction", "coulomb": 2.0} | keys}


def controller(**keys: Any) -> Changes:
    """The scene with one controller."""
    return {"controller": [keys]}


def shaper(**keys: Any) -> Changes:
    """The scene with one shaper, ZV unless it says otherwise."""
    return {"shaper": [{"kind": "zv"} | keys]}


def imperfection(kind: str, **keys: Any) -> Changes:
    """The scene with one imperfection."""
    return {"imperfection": [keys | {"kind": kind}]}


def motor(**keys: Any) -> Changes:
    """The scene with one motor for both joints."""
    return {"motor": MOTOR | keys}


REFUSED: list[tuple[Changes, str]] = [
    # keys
    ({"payload.weight": 1.0}, "`payload.weight` is not a known key: known keys here: `mass`"),
    ({"payload.one": 1, "payload.two": 2},
     "`payload.one` and `payload.two` are not known keys: known keys here: `mass`"),
    ({"trajectory.durations": 1.0}, "`trajectory.durations` is not a known key: did you mean `duration`?"),
    ({"controller[3].derivative": 1}, "controller has 3 elements, [0] to [2], named pd, second, feedforward"),
    ({"controller.pd.derivative": 1}, "controller has 3 elements"),  # two of them are of this kind
    ({"pd.derivative": 1}, "pd may be controller[0], controller[1]; write one of these, or give each a `name`"),
    ({"pid.derivative": 1}, "`pid` is not a known key"),
    ({"second.gain": 1}, "`controller[1].gain` is not a known key"),
    ({"shaper[0].kind": 1}, "shaper has no elements"),
    ({"trajectory.start[2]": 1}, "trajectory.start has 2 elements"),
    ({"payload.mass.x": 1}, "payload.mass is the value 6.0, not a section"),
    ({"payload[0]": 1}, "payload is the value"),
    ({"trajectory.kind": "table"}, "`trajectory.file` is missing"),
    ({"trajectory.kind": "table"},
     "they belong to kind 'pick-and-place', not to 'table'; remove them, or set `trajectory`"),
    (damping(kind="stiffness", time=1e-4, ratio=0.1),
     "`effects.damping.ratio` is not a known key: it belongs to kind 'modal'"),
    # and not the section of this kind
    (imperfection("delay", delay=2e-3), "`imperfection[0].delay` is not a known key"),
    (blend(kind="lame", lame=1), "`trajectory.blend.lame` is not a known key"),
    # types and ranges
    ({"payload.mass": -0.1}, "`payload.mass` must be at least 0.0 kg, got -0.1 kg"),
    ({"trajectory.duration": 0.0}, "`trajectory.duration` must be above 0.0 s, got 0.0 s"),
    ({"trajectory.duration": math.nan}, "`trajectory.duration` must be a finite number in s, got nan"),
    ({"mechanism.proximal.length": "a"}, "`mechanism.proximal.length` must be a valid number in m, got 'a'"),
    ({"payload.mass": True}, "`payload.mass` must be a valid number in kg, got True"),
    ({"effects.proximal_bending": 2.5}, "`effects.proximal_bending` must be a valid integer"),
    ({"effects.foreshortening": "yes"}, "`effects.foreshortening` must be false, true or 'exact', got 'yes'"),
    ({"trajectory.start": [1.0, 2.0, 3.0]},
     "`trajectory.start` must be an array of 2 values in m, got [1.0, 2.0, 3.0]"),
    ({"trajectory.start": [1.0, "b"]}, "`trajectory.start[1]` must be a valid number in m"),
    ({"trajectory.start": {"x": 0.1}}, "`trajectory.start` must be an array like [1.0, 2.0] in m, got {'x': 0.1}"),
    ({"effects.quasi_static": "distal_axial"}, 'must be an array like ["proximal_bending", "proximal_axial"], got'),
    (controller(kind="state-space", A=[[0.0]], B=[[1.0]], C=[[1.0]], D=1.0), "an array like [[1.0, 2.0], [1.0, 2.0]]"),
    ({"trajectory.blend": "lame"}, "`trajectory.blend` must be a table like { key = value }"),
    ({"effects.beam": "thick"}, "`effects.beam` must be 'euler-bernoulli' or 'timoshenko'"),
    # kinds
    (damping(kind="modal"), "`effects.damping.ratio` is missing"),
    (damping(kind="mass", time=1e-4), "`effects.damping.rate` is missing: add it (in 1/s)"),
    (damping(kind="foo"),
     "`effects.damping.kind` must be one of 'none', 'modal', 'stiffness', 'mass', 'rayleigh', got 'foo'"),
    (damping(ratio=0.1),
     "`effects.damping.kind` must be one of 'none', 'modal', 'stiffness', 'mass', 'rayleigh', but is missing"),
    ({"effects.damping": "modal"}, "`effects.damping.ratio` is missing: add it"),
    (profile("sine"), "`trajectory.profile.kind` must be 'poly7'"),
    (profile(None),
     "`trajectory.profile.kind` is missing: add it, one of 'poly7', 'poly5', 'bang-bang', 'trapezoidal', "),
    ({"controller": PD}, "write [[controller]] instead of [controller]"),
    ({"shaper": "zv"}, "`shaper` is a list of tables: write [[shaper]] and the keys below it, got 'zv'"),
    # mechanism and motion
    ({"name": "a/b"}, "`name` must be made of letters, digits"),
    ({"name": ".."}, "name"),  # results go into a folder of the scene's name
    ({"mechanism.assembly_mode": "right"}, "must be 'left' for `working_mode` = 'elbows-out' at the start pose"),
    ({"trajectory.start": [0.0, 5.0]}, "5.001 m from the base"),
    ({"mechanism.proximal.inner_diameter": 0.1}, "`inner_diameter` must be below `diameter` = 0.035 m"),
    ({"mechanism.base_half_distance": 100.0, "mechanism.distal.length": 380.0},
     "lengths are in m, millimetres are 1e-3 m"),
    (blend(height=0.03), "`blend.height` must be at most `height` = 0.025 m"),
    (blend(width=0.2), "`blend.width` must be at most `width`/2 = 0.175 m"),
    ({"trajectory.lift": [0.0, 0.0]}, "`lift` must be a direction"),
    (profile("poly7", ramp=0.2),
     "`ramp` = 0.2 belongs to profile `trapezoidal` or `double-s` alone: remove it from `poly7`"),
    (profile("trapezoidal"), "needs 0 < ramp <= 0.5"),
    (profile("trapezoidal", ramp=0.7), "`trajectory.profile.ramp` must be at most 0.5"),
    (profile("double-s", ramp=0.2, jerk_phase=0.15),
     "at most half of ramp = 0.2, which is 0.1 of the duration, got 0.15"),
    (profile("polynomial"), "`coefficients` is missing: profile `polynomial` needs coefficients = [0, 0, c2, c3, ...]"),
    (profile("polynomial", coefficients=[0, 0, 3, -1]), "must end at 1: its coefficients must have the sum 1, got 2"),
    # effects, and their choice
    ({"effects.quasi_static": ["distal_axial"] * 2}, "`quasi_static` names distal_axial twice"),
    ({"effects.quasi_static": ["distal_bending"]}, "`quasi_static` names distal_bending, which has no modes: give"),
    (friction(breakaway=1.0), "`breakaway` must be at least `coulomb` = 2.0 N·m"),
    (friction(velocity=0.1), "velocity` is not a known key"),
    (friction(kind="sticky"), "`effects.joint_friction.kind` must be one of 'smooth', 'stiction'"),
    ({"cosimulation.drive": "torque", "effects.transmission": {"stiffness": 1e4}},
     "needs `effects.motor_inertia` above 0"),
    (auto(distal_axial=1),
     'in `effects`: `select = "auto"` chooses `distal_axial`: remove what it chooses, or remove `select`'),
    (auto(beam="timoshenko", foreshortening=True), "chooses `beam`, `foreshortening`: remove what it chooses"),
    (auto(basis="assumed-modes"), '`select = "auto"` needs `basis = "craig-bampton"`'),
    (auto(tolerance=None), '`tolerance` is missing: `select = "auto"` needs `tolerance = 0.01`'),
    (auto(tolerance=1e-30), "`effects.tolerance` must be at least 2e-12, got 1e-30"),
    (auto(of=[]), "`of` is missing"),
    (auto(select=None, basis="craig-bampton"), '`tolerance` belongs to `select = "auto"`: add that, or remove'),
    (auto() | {"trajectory.dwell": 0.0}, "names residual_vibration_amplitude, but `trajectory.dwell` is 0 s"),
    # co-simulation
    ({"cosimulation.step": "fast"}, '`cosimulation.step`: must be a time above 0 s, or "auto"'),
    ({"cosimulation.tolerance": 1.0}, "`cosimulation.tolerance` must be at most 0.1"),
    ({"cosimulation.tolerance": 1e-13}, "must be at least 1e-12, got 1e-13: below, rounding errors decide"),
    ({"cosimulation.algorithm": "seidel"}, "'gauss-seidel', 'jacobi' or 'implicit', got 'seidel'"),
    ({"cosimulation.step_control": {"tolerance": 0.0}}, "`cosimulation.step_control.tolerance` must be above 0.0"),
    ({"cosimulation.step_control": {"tolerance": 1e-3, "minimum": 1.0, "maximum": 0.1}},
     "`minimum` must be at most `maximum` = 0.1 s, got 1.0 s"),
    ({"cosimulation.loop_solver": {"kind": "newton"}}, "must be one of 'fixed-point', 'anderson', got 'newton'"),
    # controllers
    (controller(**PD | {"proportional": -1.0}), "`controller[0].proportional[0]` must be at least 0.0 N·m/rad"),
    (controller(**PD | {"derivative": [1.0, 2.0, 3.0]}), "one number for both joints, or a list of two"),
    (controller(kind="pd", proportional=1.0, derivative=1.0), "sample_time` is missing: add it (in s)"),
    (controller(kind="pdd"), "`controller[0].kind` must be one of 'pd', 'pid'"),
    (controller(kind="python", source="module"), "`controller[0].source`"),
    (controller(**PID, anti_windup={"tracking_time": 0.1}), "'clamping', 'back-calculation', 'none', but is missing"),
    (controller(**PID, anti_windup="back-calculation"), "tracking_time` is missing: add it (in s)"),
    (controller(kind="learning", gain=1.0, cycles=0, sample_time=1e-3),
     "`controller[0].cycles` must be at least 1 cycles"),
    (controller(kind="fmu", path="a.fmu", parameters={"k": [1.0]}),
     "in `controller[0].parameters.k`: give one finite number"),
    (controller(kind="fmu", path="a.fmu", parameters={"k": math.nan}), "got nan"),
    (controller(**PD, name="plant"), "in `controller[0].name`: 'plant' is the robot's own name, choose another"),
    # shapers and imperfections
    (shaper(modes="along"), '"along-path" or a list'),
    (shaper(modes=[{"frequency": -1.0}]), "`shaper[0].modes[0].frequency` must be above 0.0 Hz"),
    (shaper(apply="sampled"), "`sample_time` in s goes with"),
    (shaper(sample_time=1e-3), "`sample_time` in s goes with"),
    (shaper(kind="si", band=[60.0, 40.0]), "got [60.0, 40.0]"),
    (shaper(name="trajectory"), "'trajectory' is the planned motion's own"),
    (imperfection("payload-error", relative=-2.0), "at least -1"),
    (imperfection("saturation", limit=1.0, lower=-1.0, upper=1.0),
     "either `limit`, which holds both ways, or `lower` and"),
    (imperfection("saturation", lower=-1.0), "or `lower` and `upper`"),
    (imperfection("saturation", lower=1.0, upper=-1.0), "`lower` must be below `upper`, got [1.0, 1.0]"),
    (imperfection("noise"), "either `standard_deviation`, for normal noise"),
    (imperfection("delay", time=1e-3, interpolation="cubic"), "'linear', 'lagrange', 'thiran', got 'cubic'"),
    (imperfection("delay", time=1e-3, signal="volume"), "'torque', 'position'"),
    # motors
    (motor(peak_torque=0.5), "`peak_torque` must be at least `continuous_torque` = 1.0 N·m, got 0.5 N·m"),
    (motor(gear_efficiency=[0.9, 1.2]), "`motor.gear_efficiency[1]` must be at most 1.0, got 1.2"),
    (motor(winding_resistance=1.0), "`winding_resistance` needs `torque_constant` [N.m/A]"),
    ({"motor": [MOTOR, MOTOR | {"gear_ratio": 2.0}]},
     "`motor[0]` has no `gear_ratio`, but the other motor has: give it"),
    ({"motor": [MOTOR] * 3}, "`motor` is one table for both joints, or a list of two, got a list of 3"),
    ({"motor": 3.0}, "`motor` must be a table like { key = value }"),
]  # fmt: skip

NAMED = {"controller": [PD, PD | {"name": "second"}, {"kind": "feedforward", "sample_time": 1e-3}]}
"""Three controllers, two of one kind, for keys that name them."""


@pytest.mark.parametrize(("changes", "words"), REFUSED)
def test_refused(changes: Changes, words: str) -> None:
    """A user sees what is wrong and what would be right, on one line that names the scene."""
    scene = load_scene("barnard2012-6kg").replace(NAMED)
    with pytest.raises(SceneError) as error:
        scene.replace(changes)
    message = str(error.value)
    assert words in message
    assert "barnard2012-6kg" in message
    assert "\n" not in message
    assert len(message) < 600
