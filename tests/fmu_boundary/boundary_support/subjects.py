"""FMUs in the form in which the tests in C need them: sources with a few numbers; and the same as files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from export_support.blocks import pd_controller
from export_support.trajectories import Swing

from boundary_support.raw import DISCARD, OK, RawInstance
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.sources import Sources, runtime_sources
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

HAND_WRITTEN = Path(__file__).parents[2] / "c-runtime" / "models.c"
EXPERIMENT = DefaultExperiment()
N_INTEGERS = 7
MECHANISM = load_scene("barnard2012-6kg").mechanism


def scene(drive: str) -> Scene:
    """The smallest robot that bends: one mode in each proximal arm; driven by torques, its motors stick."""
    friction = {"kind": "stiction", "coulomb": 1.0, "breakaway": 2.0} if drive == "torque" else {}
    modes = {"effects.proximal_bending": 1, "effects.distal_axial": 0}
    return load_scene("barnard2012-6kg").replace(
        modes | {"effects.joint_friction": friction, "cosimulation.drive": drive}
    )


SUBJECTS = ("fragile", "robot", "torque-driven robot", "block", "trajectory")


def subject(name: str, fmi: FmiVersion = "2") -> tuple[Sources, tuple[int, ...]]:
    """Sources by name, and N_INPUTS, N_SETTABLE, N_REALS (inputs first, then parameters, then outputs) and N_INTEGERS, with N_STATES and
    N_INDICATORS where there is model exchange."""
    if name == "block":
        return generate_sources(pd_controller(), EXPERIMENT, fmi=fmi), (2, 5, 6, 1)
    if name == "trajectory":
        return generate_sources(Motion(Swing(), ["axis"], "m"), EXPERIMENT, fmi=fmi), (0, 0, 3, 1)  # type: ignore[arg-type]
    if name == "fragile":  # can fail in every way
        files = runtime_sources("plant", fmi) | {"models.c": HAND_WRITTEN.read_text(encoding="utf-8")}
        return Sources("fragile", "{fragile}", "", {}, files, {}), (1, 3, 5, N_INTEGERS, 2, 0)
    model = build_model(scene("motion" if name == "robot" else "torque"))
    inputs, settable = len(model.inputs), len(model.inputs) + len(model.parameters)
    reals, states = settable + len(model.outputs) + 1, 2 * len(model.unknowns)
    counts = (inputs, settable, reals, N_INTEGERS, states, len(model.frictions))
    return generate_sources(model, EXPERIMENT, fmi=fmi), counts


FILES: dict[str, Callable[[], Path]] = {
    "robot": lambda: build_scene(scene("motion")).path,
    "block": lambda: build_fmu(pd_controller()).path,
    "trajectory": lambda: build_fmu(Motion(Swing(), ["axis"], "m")).path,  # type: ignore[arg-type]
}
"""Name → function that builds the FMU, or finds it in the cache."""


def fail_a_step(instance: RawInstance, name: str) -> None:
    """A step at 0 s that is discarded: the robot's elbows meet, the block's input leaves all numbers."""
    if name == "robot":
        joints = [instance.references[f"joint{i}.reference.position"] for i in (1, 2)]
        status, before = instance.get(joints)
        angle = math.acos(MECHANISM.base_half_distance / MECHANISM.proximal.length)
        assert (status, instance.set(joints, [angle, math.pi - angle])) == (OK, OK)
        assert instance.step(0.0, 1e-3) == DISCARD
        assert instance.set(joints, before) == OK
        return
    reference = instance.references[instance.inputs[0]]
    assert instance.set_derivative(reference, 1, 1.7e308) == OK
    assert instance.step(0.0, 2.0) == DISCARD
    assert instance.set_derivative(reference, 1, 0.0) == OK
