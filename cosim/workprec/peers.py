"""Trials with other multibody codes, where they are installed: ``pip install flexfmu[peers]``."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

from flexfmu.cosim.references import DAMPING_TIME, compare_motions
from flexfmu.cosim.workprec.fmu_trials import Announce
from flexfmu.cosim.workprec.subject import RunError, Subject
from flexfmu.cosim.workprec.trial import Curve, Trial, sweep
from flexfmu.model.errors import SceneError
from flexfmu.model.scene import ModalDamping, Scene

LINE = "Exudyn, ANCF beams"

STEPS = (1e-3, 5e-4, 2.5e-4, 1e-4)
"""Fixed steps of the generalised-alpha method [s], from which a sweep takes as many as it needs; those of its reference are shorter."""

ELEMENTS = 2
"""Beam elements a link: for the paper's scenes as accurate as the smallest of these steps."""

CONVERGED_ELEMENTS, CONVERGED_STEP = 4, 2.5e-5
"""Exudyn's own reference."""


def exudyn_trials(subject: Subject, ours: Curve, announce: Announce) -> Iterator[Trial]:
    """The same mechanism by ANCF beam elements; errors are counted from Exudyn's own converged run, since all its links bend
    and stretch whatever the scene chooses, and it has no modal damping."""
    if find_spec("exudyn") is None:
        yield Trial("tools", LINE, "", None, None, "exudyn is not installed: pip install flexfmu[peers]")
        return
    from flexfmu.cosim.workprec.exudyn_peer import ExudynMotion, simulate_exudyn

    scene = comparable(subject.scene)

    def run(step: float, elements: int) -> ExudynMotion:
        announce(f"{LINE}, step {1e3 * step:g} ms")
        return simulate_exudyn(scene, subject.motion, subject.instants, step, elements)

    try:
        converged = run(CONVERGED_STEP, CONVERGED_ELEMENTS)
    except (SceneError, RunError) as failure:
        yield failed("", failure)
        return

    def trial(step: float) -> Trial:
        label = f"{1e3 * step:g} ms"
        try:
            motion = run(step, ELEMENTS)
        except RunError as failure:
            return failed(label, failure)
        error = compare_motions(motion, converged, subject.motion, subject.instants).position
        note = f"{ELEMENTS} elements a link, from its own converged run"
        return Trial("tools", LINE, label, error, motion.time, note)

    yield from sweep(STEPS, trial, ours)


def comparable(scene: Scene) -> Scene:
    """With damping that Exudyn has, proportional to stiffness, where the scene's belongs to modes."""
    if not isinstance(scene.effects.damping, ModalDamping):
        return scene
    return scene.replace({"effects.damping": {"kind": "stiffness", "time": DAMPING_TIME}})


def failed(label: str, failure: Exception) -> Trial:
    """Why there is no result."""
    return Trial("tools", LINE, label, None, None, " ".join(str(failure).split()))
