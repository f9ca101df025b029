"""FMUs in the form in which the tests in C need them: sources with a few numbers; and the same as files."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from export_support.blocks import pd_controller
from export_support.trajectories import Swing

from boundary_support.raw import DISCARD, OK, RawInstance
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import Sources, generate_sources, runtime_sources
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

HAND_WRITTEN = Path(__file__).parents[2] / "c-runtime" / "models.c"
EXPERIMENT = DefaultExperiment()
N_INTEGERS = 7
MECHANISM = load_scene("barnard2012-6kg").mechanism


@dataclass(frozen=True)
class Subject:
    """C files by name, and the numbers of Real variables (inputs first, then parameters, then outputs) and Integers.

    Attributes:
        own: hand-written and constant files, which must compile without a warning.
        generated: CasADi's.
        guid: of the model description.
        counts: N_INPUTS, N_SETTABLE, N_REALS, N_INTEGERS, and N_STATES and N_INDICATORS where there is model exchange.
    """

    own: dict[str, str]
    generated: dict[str, str]
    guid: str
    counts: tuple[int, ...]

    @property
    def defines(self) -> tuple[str, ...]:
        """For the compiler; steps that have no end are given up early."""
        names = ("N_INPUTS", "N_SETTABLE", "N_REALS", "N_INTEGERS", "N_STATES", "N_INDICATORS")
        numbers = [f"-D{name}={count}" for name, count in zip(names, self.counts, strict=False)]
        return (f'-DGUID="{self.guid}"', *numbers, "-DFLEX_MAX_STEPS=3000.0", "-DFLEX_MAX_SAMPLES=3000.0")


def scene(drive: str) -> Scene:
    """The smallest robot that bends: one mode in each proximal arm; driven by torques, its motors stick."""
    return load_scene("barnard2012-6kg").replace(
        {
            "effects.proximal_bending": 1,
            "effects.distal_axial": 0,
            "effects.joint_friction": {"kind": "stiction", "coulomb": 1.0, "breakaway": 2.0}
            if drive == "torque"
            else {},
            "cosimulation.drive": drive,
        }
    )


def _fragile() -> Subject:
    """One that can fail in every way."""
    return Subject(
        runtime_sources("plant") | {"models.c": HAND_WRITTEN.read_text(encoding="utf-8")},
        {},
        "{fragile}",
        (1, 3, 5, N_INTEGERS, 2, 0),
    )


def _robot(drive: str) -> Subject:
    model = build_model(scene(drive))
    inputs, settable = len(model.inputs), len(model.inputs) + len(model.parameters)
    counts = (
        inputs,
        settable,
        settable + len(model.outputs) + 1,
        N_INTEGERS,
        2 * len(model.unknowns),
        len(model.frictions),
    )
    return _subject(generate_sources(model, EXPERIMENT), counts)


def _subject(sources: Sources, counts: tuple[int, ...]) -> Subject:
    return Subject(sources.runtime, sources.generated, sources.guid, counts)


def _block() -> Subject:
    return _subject(generate_sources(pd_controller(), EXPERIMENT), (2, 5, 6, 1))


def _trajectory() -> Subject:
    sources = generate_sources(Motion(Swing(), ["axis"], "m"), EXPERIMENT)  # type: ignore[arg-type]
    return _subject(sources, (0, 0, 3, 1))


SUBJECTS: dict[str, Callable[[], Subject]] = {
    "fragile": _fragile,
    "robot": lambda: _robot("motion"),
    "torque-driven robot": lambda: _robot("torque"),
    "block": _block,
    "trajectory": _trajectory,
}
"""Name → function that makes it."""

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
