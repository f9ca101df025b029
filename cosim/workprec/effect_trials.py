"""The fidelity ladder: what leaving effects out costs in accuracy, and saves in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from flexfmu.cosim.experiment import PreparedScene
from flexfmu.cosim.workprec.fmu_trials import FAILURES, Announce
from flexfmu.cosim.workprec.subject import Subject, completed
from flexfmu.cosim.workprec.trial import Trial, fastest_in_turns
from flexfmu.model.scene import Scene

RIGID: Mapping[str, object] = {
    "effects.proximal_bending": 0,
    "effects.proximal_axial": 0,
    "effects.distal_bending": 0,
    "effects.distal_axial": 0,
    "effects.quasi_static": [],
}

RICH: Mapping[str, object] = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 4,
    "effects.proximal_axial": 2,
    "effects.distal_bending": 3,
    "effects.distal_axial": 3,
    "effects.quasi_static": [],
}
"""What the ladder is measured against: all families, static and fixed-interface shapes until nothing changes any more."""


@dataclass(frozen=True)
class Rung:
    """A set of effects.

    Attributes:
        line: ladder that it belongs to.
        label: what it is called.
        changes: of the rigid scene.
    """

    line: str
    label: str
    changes: Mapping[str, object]


def ladder() -> tuple[Rung, ...]:
    """From rigid links to all families."""
    bending = [{"effects.proximal_bending": k} for k in (1, 2, 3)]
    axial = bending[2] | {"effects.distal_axial": 3}
    both = axial | {"effects.distal_bending": 1}
    static: dict[str, object] = {"effects.basis": "craig-bampton"}
    one_each = static | {"effects.proximal_bending": 1, "effects.distal_axial": 1}
    families = ["proximal_bending", "distal_axial"]
    return (
        Rung("assumed modes", "rigid", {}),
        Rung("assumed modes", "1 bending", bending[0]),
        Rung("assumed modes", "2 bending", bending[1]),
        Rung("assumed modes", "3 bending", bending[2]),
        Rung("assumed modes", "3 + 3 axial", axial),
        Rung("assumed modes", "3 + 3 + 1 distal bending", both),
        Rung("static shapes", "quasi-static 1 + 1", one_each | {"effects.quasi_static": families}),
        Rung("static shapes", "1 + 1 axial", one_each),
        Rung("static shapes", "1 + 1 + 1 distal bending", one_each | {"effects.distal_bending": 1}),
    )


def effect_trials(subject: Subject, step: float, tolerance: float, announce: Announce) -> Iterator[Trial]:
    """Every rung, its error against the richest set, its time in turns with the others; the scene's damping and loads stay."""
    announce("richest set of effects")
    options = {"communication_step": step, "tolerance": tolerance}
    rich = PreparedScene(subject.scene.replace(dict(RICH)), motion=subject.motion, **options)  # type: ignore[arg-type]
    truth = replace(subject)
    truth.__dict__["reference"] = subject.positions(completed(rich.run()))
    runs: list[tuple[Trial, PreparedScene]] = []
    for rung in ladder():
        announce(f"effects: {rung.line}, {rung.label}")
        trial, prepared = _rung_trial(truth, rung, options)
        if prepared is None:
            yield trial
        else:
            runs.append((trial, prepared))
    announce("effects: times")
    times = fastest_in_turns([prepared.run for _, prepared in runs])
    yield from (replace(trial, time=time) for (trial, _), time in zip(runs, times, strict=True))


def _rung_trial(truth: Subject, rung: Rung, options: Mapping[str, float]) -> tuple[Trial, PreparedScene | None]:
    """A rung's error, and its run where there is one to be timed."""
    try:
        scene = _with(truth.scene, rung)
        prepared = PreparedScene(scene, motion=truth.motion, **options)  # type: ignore[arg-type]
        positions = truth.positions(completed(prepared.run()))
    except FAILURES as failure:
        return Trial("effects", rung.line, rung.label, None, None, " ".join(str(failure).split())), None
    if np.isnan(positions).all():
        return Trial("effects", rung.line, rung.label, None, None, "no positions"), None
    return Trial("effects", rung.line, rung.label, truth.error(positions), None), prepared


def _with(scene: Scene, rung: Rung) -> Scene:
    """The rigid scene with the rung's effects."""
    changes = {**RIGID, **rung.changes}
    return scene.replace(changes)
