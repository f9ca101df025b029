"""Trials with other multibody codes, where they are installed: ``pip install flexfmu[peers]``."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

from flexfmu.cosim.workprec.fmu_trials import Announce
from flexfmu.cosim.workprec.subject import RunError, Subject
from flexfmu.cosim.workprec.trial import Trial
from flexfmu.model.errors import SceneError

LINE = "Exudyn, ANCF beams"

STEPS = (1e-3, 2.5e-4)
"""Fixed steps of the generalised-alpha method [s]."""

ELEMENTS = 8
"""Beam elements a link."""


def exudyn_trials(subject: Subject, announce: Announce) -> Iterator[Trial]:
    """The same mechanism by ANCF beam elements, without the damping that Exudyn doesn't have."""
    if find_spec("exudyn") is None:
        yield Trial("tools", LINE, "", None, None, "exudyn is not installed: pip install flexfmu[peers]")
        return
    from flexfmu.cosim.workprec.exudyn_peer import run_exudyn

    for step in STEPS:
        announce(f"{LINE}, step {1e3 * step:g} ms")
        try:
            positions, seconds = run_exudyn(subject.scene, subject.motion, subject.instants, step, ELEMENTS)
        except (SceneError, RunError) as failure:
            yield Trial("tools", LINE, f"{1e3 * step:g} ms", None, None, " ".join(str(failure).split()))
            continue
        note = f"{ELEMENTS} elements a link; its error is mostly that of another model"
        yield Trial("tools", LINE, f"{1e3 * step:g} ms", subject.error(positions), seconds, note)
