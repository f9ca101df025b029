"""The line of Exudyn in work-precision studies: its order, or the reason why there is none."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.benchmarks.peers import exudyn_trials
from flexfmu.cosim.studies.workprec.trial import WorkCurve, WorkPrecisionTrial, subject_of
from flexfmu.model.scene.file import load_scene

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
