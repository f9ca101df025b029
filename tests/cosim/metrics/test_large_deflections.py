"""What large deflections cost: the estimate along a run against geometrically exact elements, and against a run that has more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from formulations import compare_motions, full_scene, sample_instants, shapes_motion

from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics import small_deflections
from flexfmu.cosim.metrics.small_deflections import exceeded, kept_path_errors, path_errors
from flexfmu.model.finite_elements.motion import equilibrium, simulate
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

MakeRun = Callable[..., Run]
PAPER = load_scene("barnard2012-6kg")
FOUND = {5.0: (0.0119, 0.00022), 30.0: (0.175, 0.027)}
"""How many times softer than aluminium → error of the path without and with foreshortening, against elements."""


def softened(scene: Scene, factor: float) -> Scene:
    return scene.replace({"mechanism.material.youngs_modulus": 70e9 / factor})


def test_sag_beyond_foreshortening_is_what_bending_energy_of_fourth_order_takes_away() -> None:
    """Bent by 7 % of a link's length the robot sags 0.4 % too far, against elements: what the hardening forces take away, within a
    tenth."""
    scene = softened(full_scene(PAPER, "euler-bernoulli", True), 300.0)
    motion = plan(scene)
    joints = motion.joints.evaluate(0.0, 0)[0, 0]
    model, ours, rest = numeric_model(scene), static_equilibrium(scene, joints), standstill(joints)
    q, zeros = np.asarray(ours.elastic), np.zeros(model.n)
    change = -np.linalg.solve(model.static_stiffness(q, rest).full(), model.hardening(q).full())[:, 0]
    predicted = model.motion(q + change, zeros, zeros, rest)[0].full()[:, 0] - ours.position
    exact = equilibrium(finite_element_robot(scene, 4), joints).position - ours.position
    assert np.linalg.norm(predicted - exact) < 0.1 * np.linalg.norm(exact)


@pytest.mark.slow
@pytest.mark.parametrize("factor", FOUND)
def test_estimated_errors_are_those_against_exact_elements(factor: float) -> None:
    """Links of a soft material bend by 0.7 and 8 % of their length: errors of the path from 0.02 to 17 %, within 40 %."""
    scene = softened(PAPER, factor)
    motion, instants = plan(scene), sample_instants(plan(scene))
    exact = full_scene(scene, "euler-bernoulli", foreshortening=True)
    theirs = simulate(finite_element_robot(exact, 2), motion.joints, instants, 1e-3)
    for foreshortening, found in zip((False, True), FOUND[factor], strict=True):
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
