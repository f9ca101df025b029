"""Compiled integrators of other people on our generated functions: an independent judge of ours, or the reason why there is none."""

from __future__ import annotations

import shutil
from contextlib import suppress

import pytest

from flexfmu.benchmarks.peers import compiled_peer
from flexfmu.benchmarks.peers.compiled_peer import (
    SETTINGS,
    CompiledPeers,
    PeerMissingError,
    compiled_trials,
    fetch,
    missing,
    positions,
)
from flexfmu.cosim.experiment.accuracy import WorkCurve
from flexfmu.cosim.studies.workprec.trial import subject_of
from flexfmu.model.scene.file import load_scene

SCENE = load_scene("barnard2012-6kg").replace({"trajectory.dwell": 0.0})
LOOP = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
}


@pytest.mark.slow
@pytest.mark.parametrize(("peer", "tolerance"), [("RADAU5", 1e-11), ("SUNDIALS IDA", 1e-9)])
@pytest.mark.parametrize("changes", [{}, LOOP], ids=["motion", "PD"])
def test_peers_agree_with_our_reference(peer: str, tolerance: float, changes: dict[str, object]) -> None:
    """RADAU5 and IDA on the same functions, with neither our integrator nor our master, come as near to our run at 1e-12 as
    their tolerances let them: with prescribed joints, and under control that samples and holds."""
    with suppress(PeerMissingError):
        fetch()
    if note := missing(peer):
        pytest.skip(note)
    subject = subject_of(SCENE.replace(changes))
    peers = CompiledPeers(subject.scene)
    for setting in SETTINGS[peer]:
        assert subject.error(positions(peers.run(setting, tolerance, repeat=1))) < 1e-6


def test_what_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a Fortran compiler and SUNDIALS, a study says what to install instead of ending."""
    which = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name, *rest: None if name == "gfortran" else which(name, *rest))
    monkeypatch.setattr(compiled_peer, "_has_sundials", lambda compiler: False)
    trials = list(compiled_trials(subject_of(SCENE), WorkCurve(())))
    assert [trial.line for trial in trials] == [*SETTINGS]
    assert "gfortran" in trials[0].note
    assert all(trial.failed and "apt-get install" in trial.note for trial in trials)
