"""Variants side by side are the runs that they would be alone, within the tolerance, whatever their neighbours do."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.lockstep import Lockstep, SampledInputs
from flexfmu.cosim.engine.master.grid import time_grid
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.system import scene_system
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.many.variants import VariantError, VariantResult, run_variants
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS
from flexfmu.cosim.metrics.metrics import PeakMetrics, measuring, metrics_of
from flexfmu.fmu_build.batch_build import batch_library, lanes_of_processor
from flexfmu.fmu_build.codegen import LANES_FILE
from flexfmu.fmu_build.errors import ModelError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.02})
STEP, TOLERANCE = 1e-3, 1e-6
NAMES = ("payload.mass", "proximal.diameter", "material.youngs_modulus", "damping.ratio", "distal.length")
BASE = (6.0, 0.035, 70e9, 0.1357, 0.38079)
OUTPUTS = ("joint1.torque", "joint2.torque", "end_effector.position.x", "link11.tip_deflection", "joint1.torque")
LANES = [lanes for lanes in (1, 4, 8) if lanes <= lanes_of_processor()]

factors = st.tuples(
    st.floats(0.02, 1.5), st.floats(0.9, 1.2), st.floats(0.8, 1.2), st.floats(0.5, 2.0), st.floats(0.97, 1.1)
)


@cache
def lockstep(lanes: int, order: int = 2) -> Lockstep:
    """The solver of variants of the scene."""
    fmu, loop = build_scene(SCENE).path, loop_of(SCENE)
    parts = scene_system(SCENE, loop, fmu)
    references = parts.references
    grid = time_grid(0.0, loop.motion.stop_time, STEP, references.breakpoints)
    references.prepare(grid.times)
    names = [each.name for each in references.variables]
    polynomials, kinds = references.announced[:-1], [0, 0, 1, 1, 2, 2]
    course = SampledInputs(grid.times, grid.marked, names, references.ended[0, 0], polynomials, kinds, 200)
    return Lockstep(fmu, parts.plant.parameters, course, NAMES, OUTPUTS, order=order, tolerance=TOLERANCE, lanes=lanes)


@cache
def prepared() -> PreparedScene:
    return PreparedScene(SCENE, communication_step=STEP, tolerance=TOLERANCE)


def alone(values: Sequence[float]) -> np.ndarray[Any, Any]:
    """(n, 3, instants) the outputs of a run of the FMU with two derivatives."""
    run = prepared().run(dict(zip(NAMES, values, strict=True)))
    columns = [run.recording[name] for name in OUTPUTS]
    return np.array([[each.values, each.first, each.second] for each in columns])


def sizes(recording: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """(n, orders, 1) the largest magnitude of each output and derivative."""
    largest: np.ndarray[Any, Any] = abs(recording).max(axis=-1, keepdims=True)
    return largest


@pytest.mark.parametrize("lanes", LANES)
def test_recordings_are_those_of_the_fmu(lanes: int) -> None:
    """Values within the tolerance; derivatives lose up to two digits an order, as between runs of other tolerances."""
    variants = np.array(BASE) * np.linspace(0.5, 1.0, 5)[:, None] ** np.array([2.0, 0.1, 0.2, 1.0, 0.05])
    found, failed = lockstep(lanes).record(variants)
    assert not failed.any()
    for values, recording in zip(variants, found, strict=True):
        expected = alone(values)
        error = (abs(recording - expected) / sizes(expected)).max(axis=(0, 2))
        assert error[0] < 10 * TOLERANCE
        assert error[1] < 1e3 * TOLERANCE
        assert error[2] < 1e4 * TOLERANCE


@pytest.mark.parametrize("lanes", LANES)
@settings(max_examples=10)
@given(st.lists(factors, min_size=1, max_size=11), st.randoms(use_true_random=False))
def test_neighbours_change_nothing(lanes: int, drawn: list[tuple[float, ...]], random: Any) -> None:
    """Shuffled, in batches that are full or not: each variant stays the same within the tolerance."""
    variants = np.array(BASE) * np.array(drawn)
    order = list(range(len(drawn)))
    random.shuffle(order)
    solver = lockstep(lanes)
    peaks, failed = solver.peaks(variants, 0.2)
    shuffled, failed_too = solver.peaks(variants[order], 0.2)
    single, failed_alone = solver.peaks(variants[:1], 0.2)
    assert not failed.any()
    assert not failed_too.any()
    assert not failed_alone.any()
    np.testing.assert_allclose(shuffled, peaks[order], rtol=10 * TOLERANCE)
    np.testing.assert_allclose(single[0], peaks[0], rtol=10 * TOLERANCE)
    # an output that is asked for twice is the same twice
    np.testing.assert_array_equal(peaks[:, 0], peaks[:, 4])


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize(
    "bad",
    [(6.0, 1e-9, *BASE[2:]), (6.0, 0.035, 1e3, *BASE[3:]), (np.nan, *BASE[1:]), (*BASE[:4], 0.3)],
    ids=["no inertia", "no stiffness", "no number", "out of reach after 55 ms"],
)
def test_a_neighbour_that_fails_leaves(lanes: int, bad: tuple[float, ...]) -> None:
    """At the start or on its way; the others go on, in whichever lane it was, as long as one is left."""
    assert lockstep(lanes).peaks(np.array([bad, bad]), 0.2)[1].all()
    variants = np.array([(mass, *BASE[1:]) for mass in (0.5, 2.0, 4.0, 6.0)])
    expected, _ = lockstep(lanes).peaks(variants, 0.2)
    for place in (0, 2, 4):
        found, failed = lockstep(lanes).peaks(np.insert(variants, place, bad, axis=0), 0.2)
        assert failed.tolist() == [i == place for i in range(5)]
        np.testing.assert_allclose(np.delete(found, place, axis=0), expected, rtol=10 * TOLERANCE)


def assert_alike(
    variants: Sequence[dict[str, Any]],
    measure: Any,
    rel: float,
    scene: Scene = SCENE,
    step: float = STEP,
    part: int = 1,
) -> list[VariantResult[Any]]:
    """Results side by side, of which some (each of number ``part``) are compared with those of runs of the FMU."""
    tolerance = TOLERANCE if scene is SCENE else None
    options: dict[str, Any] = {"communication_step": step, "tolerance": tolerance}
    side_by_side = run_variants(scene, variants, measure, **options)
    singly = run_variants(scene, variants[::part], partial(metrics_of, names=measure.names), **options)
    for one, other in zip(side_by_side[::part], singly, strict=True):
        assert one.changes == other.changes
        assert (one.value is None) == (other.value is None)
        for name, value in (other.value or {}).items():
            assert one.value[name] == (None if value is None else pytest.approx(value, rel=rel)), name
    return side_by_side


def test_metrics_are_those_of_the_fmu() -> None:
    """Peaks between communication points from derivatives at a few of them; all metrics from whole recordings, where small
    differences of large numbers lose digits."""
    variants = [{"payload.mass": mass} for mass in np.linspace(0.1, 8.0, 17)]
    measure = measuring(["peak_torque_1", "peak_torque_2", "peak_tip_deflection_1"])
    assert isinstance(measure, PeakMetrics)
    assert_alike(variants, measure, 10 * TOLERANCE)
    found = assert_alike(
        [{"payload.mass": mass} for mass in np.linspace(2.0, 8.0, 17)], measuring(COMMON_METRICS), 1e-3
    )
    assert all(each.value and each.value.keys() == COMMON_METRICS.keys() for each in found)


@pytest.mark.skipif(LANES[-1] == 1, reason="one lane has one duration")
def test_durations_side_by_side() -> None:
    """Motions of one shape, slower and faster, with other payloads: each has its own time in the same steps."""
    durations, masses = np.linspace(0.18, 0.3, 34), np.linspace(2.0, 6.0, 34)
    variants: list[dict[str, Any]] = [
        {"trajectory.duration": float(duration), "payload.mass": float(mass)}
        for duration, mass in zip(durations, masses, strict=True)
    ]
    shuffled = [variants[i] for i in np.random.default_rng(1).permutation(34)]
    shuffled.insert(5, {"trajectory.duration": -1.0})
    found = assert_alike(shuffled, measuring(["peak_torque_1", "peak_torque_2"]), 10 * TOLERANCE)
    assert [each.error is None for each in found] == [i != 5 for i in range(35)]


SCENES: dict[str, dict[str, Any]] = {
    "rigid": {"effects.proximal_bending": 0, "effects.distal_axial": 0},
    "friction": {"effects.joint_friction": {"viscous": 0.5, "coulomb": 1.0, "velocity": 0.05}},
    "undamped": {"effects.damping": {"kind": "none"}, "cosimulation.tolerance": 1e-8},
    "fixed steps": {"cosimulation.integrator_step": 5e-4},
    "explicit": {"cosimulation.integrator": "dopri5"},
}


@pytest.mark.parametrize("changes", SCENES.values(), ids=SCENES)
def test_other_scenes(changes: dict[str, Any]) -> None:
    """Effects, tolerances and methods; explicit steps have one time for all, so other durations are left to the FMU.

    The communication step resolves undamped modes, since variants have peaks between other communication points than the FMU.
    """
    for key, low, high in (("payload.mass", 1.0, 6.0), ("trajectory.duration", 0.18, 0.2)):
        variants = [{key: float(value)} for value in np.linspace(low, high, 16)]
        found = assert_alike(
            variants, measuring(["peak_torque_1", "peak_torque_2"]), 1e-5, SCENE.replace(changes), 2e-4, 5
        )
        assert all(each.value for each in found)


def test_what_cannot_go_along_is_run_by_the_fmu() -> None:
    """With its own message, and every variant counted once."""
    variants: list[dict[str, Any]] = [{"payload.mass": float(mass)} for mass in range(17)]
    variants[3] = {"payload.mass": -1.0}
    variants[5] = {"payload.weight": 1.0}
    variants[7] = {"distal.length": 0.05}
    variants[9] = {"initial": "undeformed"}
    told: list[float] = []
    found = run_variants(
        SCENE, variants, measuring(["peak_torque_1"]), communication_step=STEP, tolerance=1e-4, progress=told.append
    )
    assert told[-1] == 1.0
    assert np.all(np.diff(told) > 0.0)
    errors = {i: each.error for i, each in enumerate(found) if each.error is not None}
    assert {i: type(error) for i, error in errors.items()} == {3: InputError, 5: InputError, 7: VariantError}
    assert "payload.mass must be at least 0 kg" in str(errors[3])
    assert found[9].value is not None


def test_controlled_robots_and_several_processes() -> None:
    """A robot that is driven by torques isn't simulated in lockstep; processes change nothing but the time."""
    measure = measuring(["peak_torque_1"])
    variants = [{"payload.mass": float(mass)} for mass in range(1, 18)]
    pd = {"kind": "pd", "proportional": 2e3, "derivative": 40.0, "sample_time": 1e-3}
    driven = SCENE.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.05, "controller": [pd]})
    for scene in (SCENE, driven):
        one = run_variants(scene, variants, measure, communication_step=STEP, tolerance=1e-4)
        two = run_variants(scene, variants, measure, communication_step=STEP, tolerance=1e-4, processes=2)
        assert [each.error for each in one] == [None] * 17
        for single, shared in zip(one, two, strict=True):
            assert single.value == pytest.approx(shared.value, rel=1e-3)
    with pytest.raises(InputError, match="whole number of processes from 1 on, got 0"):
        run_variants(SCENE, variants, measure, processes=0)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("gcc"), reason="preloads GCC's sanitizers")
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """Variants that fail and others, in the widest library; with few shapes, as the compiler takes a minute for all."""
    script = (
        "import numpy as np, test_lockstep as t\n"
        "t.SCENE = t.SCENE.replace({'effects.proximal_bending': 1, 'effects.distal_axial': 0})\n"
        "variants = np.array([(mass, *t.BASE[1:]) for mass in (0.5, np.nan, 2.0, 6.0, 3.0)] + [(*t.BASE[:4], 0.3)])\n"
        "for lanes in t.LANES[-1:]:\n"
        "    solver = t.lockstep(lanes)\n"
        "    assert solver.peaks(variants, 0.2, time_scales=np.linspace(1.0, 1.1, 6))[1].tolist() == [0, 1, 0, 0, 0, 1]\n"
        "    assert solver.record(variants)[1].tolist() == [0, 1, 0, 0, 0, 1]\n"
    )
    libraries = [
        subprocess.run(["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    # no sanitizer in the compiler itself; the last optimisation counts
    compiler, flags = tmp_path / "gcc", "-O1 -fsanitize=address,undefined -fno-sanitize-recover=all"
    compiler.write_text(f'#!/bin/sh\nexec env -u LD_PRELOAD {shutil.which("gcc")} "$@" {flags}\n')
    compiler.chmod(0o755)
    environment = os.environ | {
        "CC": str(compiler),
        "FLEXFMU_CACHE": str(tmp_path),
        "LD_PRELOAD": " ".join(libraries),
        "ASAN_OPTIONS": "detect_leaks=0",
        "PYTHONPATH": str(Path(__file__).parent),
    }
    ran = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_branches_have_no_lanes(tmp_path: Path) -> None:
    """A function that chooses would send all lanes one way."""
    with zipfile.ZipFile(tmp_path / "branches.fmu", "w") as archive:
        archive.writestr("sources/model_residual.c", "casadi_real a1=(a0<a2);")
    with pytest.raises(ModelError, match=r"model_residual\.c has one"):
        batch_library(tmp_path / "branches.fmu", 1)


COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
HAS_LANES = sys.platform == "linux" and platform.machine() == "x86_64"

SHORT: dict[str, Any] = {"trajectory.duration": 0.2, "trajectory.dwell": 0.05, "cosimulation.step": 1e-3}
FOUR_LANES: dict[str, dict[str, Any]] = {
    "radau": {"cosimulation.tolerance": 1e-5},
    "gauss4": {"cosimulation.tolerance": 1e-8},
    "gauss2": {"cosimulation.integrator": "gauss2"},
    "odd count": {"effects.distal_bending": 1, "effects.proximal_axial": 2, "effects.gravity": [0.0, 0.0]},
    "torques": {"cosimulation.drive": "torque", "effects.motor_inertia": 0.05},
}


@pytest.mark.skipif(not HAS_LANES or COMPILER is None, reason="the reference is linux64: lanes need its registers")
@pytest.mark.parametrize("changes", FOUR_LANES.values(), ids=FOUR_LANES)
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
