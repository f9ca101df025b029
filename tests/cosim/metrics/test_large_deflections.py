"""What large deflections cost: the estimate along a run against geometrically exact elements, and against a run that has more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from formulations import Beam, compare_motions, full_scene, sample_instants, shapes_motion

from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics import small_deflections
from flexfmu.cosim.metrics.small_deflections import exceeded, kept_path_errors, path_errors
from flexfmu.model.finite_elements.motion import equilibrium, simulate
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

MakeRun = Callable[..., Run]
PAPER = load_scene("barnard2012-6kg")
FOUND = {5.0: (0.02, 0.0119, 0.00012), 30.0: (0.25, 0.175, 0.027)}
"""How many times softer than aluminium → dwell [s], error of the path without and with foreshortening, against elements."""


def softened(scene: Scene, factor: float) -> Scene:
    return scene.replace({"mechanism.material.youngs_modulus": 70e9 / factor})


@pytest.mark.parametrize("beam", ["euler-bernoulli", "timoshenko"])
def test_exact_bending_sags_as_elements_do(beam: Beam) -> None:
    """Bent by 7 and 13 % of a link's length, to second order the robot sags 0.4 and 1.3 % too far; exactly, by 0.01 % at most."""
    for factor, second_order in ((300.0, 3.5e-3), (600.0, 13e-3)):
        scene = softened(full_scene(PAPER, beam, True), factor)
        joints = plan(scene).joints.evaluate(0.0, 0)[0, 0]
        theirs, rigid = (
            equilibrium(finite_element_robot(scene, 8), joints).position,
            plan(scene).task.evaluate(0.0, 0)[0, 0],
        )
        for kind, error in ((True, second_order), ("exact", 0.0)):
            ours = static_equilibrium(scene.replace({"effects.foreshortening": kind}), joints).position
            found = np.linalg.norm(ours - theirs) / np.linalg.norm(theirs - rigid)
            assert found == pytest.approx(error, rel=0.1, abs=1e-4)


@pytest.mark.slow
def test_thin_robots_move_as_somebody_elses_beams() -> None:
    """Rods of 6 mm bend by 8 % of their length: 3 % of the path's error is missing to second order, 0.1 % with exact bending (ANCF
    beams of Exudyn, whose steps leave 0.06 %; 0.01 % against co-rotational elements)."""
    pytest.importorskip("exudyn", reason="exudyn isn't installed: pip install flexfmu[peers]")
    from flexfmu.benchmarks.peers.exudyn_peer import simulate_exudyn

    rods = dict.fromkeys(("mechanism.proximal.diameter", "mechanism.distal.diameter"), 0.006)
    scene = load_scene("barnard2012-0.1kg").replace(rods)
    motion, instants = plan(scene), sample_instants(plan(scene))
    short, exact = (full_scene(scene, "euler-bernoulli", kind) for kind in (True, "exact"))
    elements = simulate(finite_element_robot(short, 4), motion.joints, instants, 1e-3)
    somebody = simulate_exudyn(short, motion, instants, 1e-4, 4)
    # to second order the FMU is that of the test below
    fmu = build_scene(full_scene(PAPER, "euler-bernoulli", True)).path
    second_order, ours = shapes_motion(short, instants, fmu), shapes_motion(exact, instants)
    for found, reference, least, most in (
        (second_order, elements, 0.03, 0.04),
        (ours, elements, 0.0, 1e-4),
        (ours, somebody, 0.0, 1e-3),
    ):
        assert least <= compare_motions(found, reference, motion, instants).position <= most


@pytest.mark.slow
@pytest.mark.parametrize("factor", FOUND)
def test_estimated_errors_are_those_against_exact_elements(factor: float) -> None:
    """Links of a soft material bend by 0.7 and 8 % of their length: errors of the path from 0.02 to 17 %, within 40 %."""
    dwell, *errors = FOUND[factor]
    scene = softened(PAPER, factor).replace({"trajectory.dwell": dwell})
    motion, instants = plan(scene), sample_instants(plan(scene))
    exact = full_scene(scene, "euler-bernoulli", foreshortening=True)
    theirs = simulate(finite_element_robot(exact, 4), motion.joints, instants, 1e-3)
    for foreshortening, found in zip((False, True), errors, strict=True):
        ours = full_scene(scene, "euler-bernoulli", foreshortening)
        fmu = build_scene(full_scene(PAPER, "euler-bernoulli", foreshortening)).path
        true = compare_motions(shapes_motion(ours, instants, fmu), theirs, motion, instants).position
        estimated = path_errors(run_scene(ours, communication_step=1e-3, fmu_path=fmu))[0]
        assert true == pytest.approx(found, rel=0.1)
        assert estimated == pytest.approx(true, rel=0.4)


@pytest.mark.slow
def test_large_deflections_name_foreshortening_where_it_suffices() -> None:
    """A warning's figure is what foreshortening changes in the path, it is named as the remedy, and with it the warning is gone;
    aluminium isn't warned of."""
    bends = PAPER.replace({"effects.distal_axial": 0, "effects.proximal_bending": 1})
    assert exceeded(run_scene(bends)) == []
    scene = softened(bends, 12.0)
    short = scene.replace({"effects.foreshortening": True})
    runs = [run_scene(each) for each in (scene, short)]
    paths = [np.stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"]) for run in runs]
    rigid = np.stack([runs[0].recording[f"end_effector.reference.position.{axis}"].values for axis in "xy"])
    changed, largest = (np.linalg.norm(each, axis=0).max() for each in (paths[1] - paths[0], paths[0] - rigid))
    (sentence,) = exceeded(runs[0])
    assert "set `effects.foreshortening = true`, which leaves about" in sentence
    assert path_errors(runs[0])[0] == pytest.approx(changed / largest, rel=0.2)
    assert exceeded(runs[1]) == []


def test_an_estimate_is_made_once_for_equal_runs(
    make_run: MakeRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The cache has it to the last bit; another recording, payload or damaged file is estimated anew."""
    estimate = Mock(return_value=(0.1 + 0.2, 1e-300))
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path))
    monkeypatch.setattr(small_deflections, "path_errors", estimate)
    run = make_run()
    other = replace(run, parameters={"payload.mass": 3.0})
    moved = replace(run, recording=run.recording.with_columns({"x": Column("m", run.recording.time)}))
    for each in (run, run, other, moved, moved, run):
        assert kept_path_errors(each) == (0.1 + 0.2, 1e-300)
    assert estimate.call_count == 3
    for file in (tmp_path / "path-errors").iterdir():
        file.write_bytes(b"damaged")
    assert kept_path_errors(run) == (0.1 + 0.2, 1e-300)
    assert estimate.call_count == 4
