"""The model of shapes against formulations of another kind, on the paper's scenes.

Finite elements and Exudyn's beams keep the length of their axis when they bend, as links do. With foreshortening the model of
shapes does so as well, and what remains is its finite number of shapes and the second order in the deflections: 2e-5.
Without it up to 2e-3 of the path error is missing at 6 kg, which is what foreshortening is there for.
Reached figures: docs/references.md.
"""

from __future__ import annotations

from dataclasses import astuple
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from formulations import FREQUENCIES, Beam, compare_at_rest, compare_motions, full_scene, sample_instants, shapes_motion

from flexfmu.benchmarks.peers import exudyn_trials
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.studies.workprec.trial import subject_of
from flexfmu.model.finite_elements.motion import element_frequencies, simulate
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.scene.file import load_scene
from flexfmu.model.statics import natural_frequencies

SCENES = ("barnard2012-6kg", "barnard2012-0.1kg")
WITH, WITHOUT = 1e-3, 2e-3
"""Bounds with and without foreshortening."""


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(
    ("beam", "foreshortening", "bound"),
    [
        ("euler-bernoulli", False, WITHOUT),
        ("euler-bernoulli", True, WITH),
        pytest.param("timoshenko", True, WITH, marks=pytest.mark.slow),
    ],
)
def test_frequencies_and_sag_agree_with_elements(name: str, beam: Beam, foreshortening: bool, bound: float) -> None:
    """Four frequencies at five poses, static deflection and holding torques, by two formulations."""
    scene = full_scene(load_scene(name), beam, foreshortening)
    agreement = compare_at_rest(scene, plan(scene), finite_element_robot(scene, 6))
    assert agreement.frequency < bound
    assert agreement.sag < (1e-5 if foreshortening else bound)
    assert agreement.torque < 1e-6


@pytest.mark.slow
def test_frequencies_converge_with_a_payload_that_turns() -> None:
    """Its moment on the tip of link 12 has no static shape among pinned-pinned modes: errors fall like 1 / modes, to zero."""
    scene = full_scene(load_scene(SCENES[0]), "euler-bernoulli", True).replace({"payload.inertia": 2e-3})
    joints = plan(scene).joints.evaluate(0.0, 0)[0, 0]
    exact = element_frequencies(finite_element_robot(scene, 6), joints, FREQUENCIES)
    few, many = (
        natural_frequencies(scene.replace({"effects.distal_bending": modes}), joints)[:FREQUENCIES] / exact - 1.0
        for modes in (3, 6)
    )
    assert few.max() > 5e-3
    assert many.max() == pytest.approx(0.5 * few.max(), rel=0.15)


@lru_cache
def fmu_of_shapes(foreshortening: bool) -> Path:
    """One serves all payloads."""
    return build_scene(full_scene(load_scene(SCENES[0]), "euler-bernoulli", foreshortening)).path


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("reference", ["elements", "Exudyn"])
def test_runs_agree(name: str, reference: str) -> None:
    """Path, accelerations and torques over the whole motion and dwell, against converged co-rotational elements and against
    somebody else's program (ANCF beams, algebraic joints, generalised-alpha): below their bounds with and without foreshortening,
    which the references have."""
    scene = load_scene(name)
    motion, exact = plan(scene), full_scene(scene, "euler-bernoulli", foreshortening=True)
    instants = sample_instants(motion)
    if reference == "elements":
        theirs = simulate(finite_element_robot(exact, 2), motion.joints, instants, 5e-4)
    else:
        pytest.importorskip("exudyn", reason="exudyn isn't installed: pip install flexfmu[peers]")
        from flexfmu.benchmarks.peers.exudyn_peer import simulate_exudyn

        step = 1e-4 if scene.payload.mass > 1.0 else 5e-5
        theirs = simulate_exudyn(exact, motion, instants, step=step, elements=4)
    for foreshortening, bound in ((True, WITH), (False, WITHOUT)):
        full = full_scene(scene, "euler-bernoulli", foreshortening)
        ours = shapes_motion(full, instants, fmu_of_shapes(foreshortening))
        agreement = compare_motions(ours, theirs, motion, instants)
        assert max(astuple(agreement)) < bound, (foreshortening, agreement)


SCENE = load_scene("barnard2012-6kg").replace({"trajectory.dwell": 0.0})


def trials(**changes: object) -> list[WorkPrecisionTrial]:
    """Exudyn's trials of the scene with changed keys."""
    scene = SCENE.replace({key.replace("__", "."): value for key, value in changes.items()})
    return list(exudyn_trials.exudyn_trials(subject_of(scene), WorkCurve(())))


@pytest.mark.slow
def test_errors_fall_with_the_steps_square(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted from its own converged run, generalised-alpha has the second order that it should have, so that errors of its
    time steps are what is seen, not another model's."""
    pytest.importorskip("exudyn", reason="exudyn isn't installed: pip install flexfmu[peers]")
    monkeypatch.setattr(exudyn_trials, "EXUDYN_STEPS", (5e-4, 2.5e-4))
    coarse, fine = trials()
    assert coarse.error is not None
    assert fine.error is not None
    assert np.log2(coarse.error / fine.error) == pytest.approx(2.0, abs=0.3)
    assert fine.error < 2e-3


@pytest.mark.slow
def test_what_exudyn_lacks_is_told() -> None:
    """A scene with shear is a failed trial that names the key, not a run without shear."""
    pytest.importorskip("exudyn", reason="exudyn isn't installed: pip install flexfmu[peers]")
    (trial,) = trials(effects__beam="timoshenko")
    assert trial.failed
    assert "effects.beam" in trial.note


def test_exudyn_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra a study says what to install."""
    monkeypatch.setattr(exudyn_trials, "find_spec", lambda name: None)
    (trial,) = trials()
    assert trial.failed
    assert "flexfmu[peers]" in trial.note
