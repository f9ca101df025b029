"""Work-precision trials with Exudyn, another multibody code, where it is installed (``pip install flexfmu[peers]``)."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

import numpy as np

from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.studies.workprec.trial import RunError, SceneUnderTest, sweep
from flexfmu.model.scene.effects import ModalDampingSection
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene

DAMPING_TIME = 2e-4
"""Ratio of viscous to elastic forces [s]: 4 % damping of the first mode with 6 kg, 8 % with 0.1 kg."""

EXUDYN_LINE = "Exudyn, ANCF beams"

EXUDYN_STEPS = (1e-3, 5e-4, 2.5e-4, 1e-4)
"""Fixed steps of the generalised-alpha method [s], from which a sweep takes as many as it needs; those of its reference are shorter."""

ELEMENTS = 2
"""Beam elements a link: for the paper's scenes as accurate as the smallest of these steps."""

CONVERGED_ELEMENTS, CONVERGED_STEP = 4, 2.5e-5
"""Exudyn's own reference."""


def exudyn_trials(subject: SceneUnderTest, ours: WorkCurve) -> Iterator[WorkPrecisionTrial]:
    """The same mechanism by ANCF beam elements; errors are counted from Exudyn's own converged run, since all its links bend
    and stretch whatever the scene chooses, and it has no modal damping."""
    if find_spec("exudyn") is None:
        yield WorkPrecisionTrial(
            "tools", EXUDYN_LINE, "", None, None, "exudyn is not installed: pip install flexfmu[peers]"
        )
        return
    from flexfmu.benchmarks.peers.exudyn_peer import ExudynMotion, simulate_exudyn

    # Exudyn's own converged run is what errors are counted from
    scene = comparable(subject.scene)

    def run(step: float, elements: int) -> ExudynMotion:
        subject.announce(f"{EXUDYN_LINE}, step {1e3 * step:g} ms")
        return simulate_exudyn(scene, subject.motion, subject.instants, step, elements)

    try:
        converged = run(CONVERGED_STEP, CONVERGED_ELEMENTS)
    except (SceneError, RunError) as failure:
        yield WorkPrecisionTrial("tools", EXUDYN_LINE, "", None, None, " ".join(str(failure).split()))
        return
    rigid = subject.motion.task.evaluate(subject.instants, 0)[0]
    deviation = float(np.linalg.norm(converged.position - rigid, axis=1).max())

    def trial(step: float) -> WorkPrecisionTrial:
        def measure() -> tuple[float, float, str]:
            motion = run(step, ELEMENTS)
            error = float(np.linalg.norm(motion.position - converged.position, axis=1).max()) / deviation
            return error, motion.time, f"{ELEMENTS} elements a link, from its own converged run"

        return subject.trial("tools", EXUDYN_LINE, f"{1e3 * step:g} ms", measure)

    yield from sweep(EXUDYN_STEPS, trial, ours)


def comparable(scene: Scene) -> Scene:
    """Return the scene with stiffness-proportional damping instead of modal damping, which Exudyn lacks."""
    if not isinstance(scene.effects.damping, ModalDampingSection):
        return scene
    return scene.replace({"effects.damping": {"kind": "stiffness", "time": DAMPING_TIME}})
