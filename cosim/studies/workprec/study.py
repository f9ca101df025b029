"""The whole study of a scene: every family of trials, the references that errors are counted from, and what they say in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from flexfmu.cosim.studies.workprec import fmu_trials, solver_trials, tool_trials
from flexfmu.cosim.studies.workprec.fmu_trials import Announce
from flexfmu.cosim.studies.workprec.tool_trials import PAPER_LINE
from flexfmu.cosim.studies.workprec.trial import Curve, SceneUnderTest, Trial, subject_of
from flexfmu.model.scene.schema import Scene

STEP = 1e-3
"""Communication step at which integrators, tools and effects are compared [s]."""

OURS = "flexfmu"
"""Line of the best of our integrators' settings among other tools."""

LADDER_TOLERANCE = 1e-8
"""Of the integrator while effects are compared."""


@dataclass(frozen=True)
class WorkPrecisionStudy:
    """What was found out about a scene.

    Attributes:
        scene: what was simulated.
        duration: simulated time [s].
        scale: what elasticity does [m]; errors are relative to it.
        agreement: relative difference of two independent references; None where there is only one.
        references: how they were made.
        trials: every measured point.
    """

    scene: Scene
    duration: float
    scale: float
    agreement: float | None
    references: str
    trials: tuple[Trial, ...]

    def family(self, name: str) -> tuple[Trial, ...]:
        """The trials of one family."""
        return tuple(each for each in self.trials if each.family == name)


FAMILIES = ("integrators", "communication", "algorithms", "effects", "formulations", "tools")
"""Questions that can be asked, in this order."""


def run_study(scene: Scene, families: Sequence[str], announce: Announce, step: float = STEP) -> WorkPrecisionStudy:
    """Measure.

    Args:
        scene: the scene.
        families: which of `FAMILIES`; those that a scene has no answer for are left out.
        announce: called with what is being tried.
        step: communication step of the comparisons [s].

    Raises:
        RunError: the reference can't be calculated.
        TrajectoryError, InputError, BuildError: as for `flexfmu.cosim.experiment.prepared_scene.run_scene`.
    """
    subject = subject_of(scene)
    announce("reference")
    _ = subject.reference
    agreement, references = _check_reference(subject, announce)
    trials: list[Trial] = []
    makers = _makers(subject, step, announce, trials)
    for name in (each for each in FAMILIES if each in families):
        trials += makers[name]()
    return WorkPrecisionStudy(scene, subject.stop, subject.scale, agreement, references, tuple(trials))


def _makers(
    subject: SceneUnderTest, step: float, announce: Announce, known: Sequence[Trial]
) -> dict[str, Callable[[], Iterator[Trial]]]:
    """Family → what makes its trials, given those of the families before it."""
    has_equations = is_differential_equation(subject.scene)

    def nothing() -> Iterator[Trial]:
        return iter(())

    def tools() -> Iterator[Trial]:
        measured = [each for each in known if each.family == "integrators"]
        ours = Curve.of(measured or fmu_trials.integrator_trials(subject, step, announce, ("automatic",), ()))
        for each in ours.trials:
            yield replace(each, family="tools", line=OURS, label=f"{each.line} {each.label}")
        yield from solver_trials.scipy_trials(subject, ours, announce)
        yield from solver_trials.sundials_trials(subject, ours, announce)
        yield from tool_trials.model_exchange_trials(subject, ours, announce)
        yield tool_trials.paper_trial(subject, announce)
        yield from tool_trials.exudyn_trials(subject, ours, announce)

    return {
        "integrators": lambda: fmu_trials.integrator_trials(subject, step, announce),
        "communication": (lambda: fmu_trials.coupling_trials(subject, announce)) if has_equations else nothing,
        "algorithms": (lambda: fmu_trials.algorithm_trials(subject, announce)) if subject.scene.controller else nothing,
        "effects": (lambda: fmu_trials.effect_trials(subject, step, LADDER_TOLERANCE, announce)),
        "formulations": (lambda: solver_trials.formulation_trials(subject, announce)) if has_equations else nothing,
        "tools": tools if has_equations else nothing,
    }


def is_differential_equation(scene: Scene) -> bool:
    """Whether the scene is one smooth equation between breakpoints: motion-driven, elastic, nothing in the loop or sampled."""
    is_sampled = any(getattr(each, "apply", "sampled") == "sampled" for each in scene.shaper)
    return scene.cosimulation.drive == "motion" and not (scene.controller or scene.imperfection or is_sampled)


def _check_reference(subject: SceneUnderTest, announce: Announce) -> tuple[float | None, str]:
    """Compare the reference with one that shares neither integrator nor master."""
    own = "our FMU, Gauss collocation at 1e-12, 0.25 ms steps"
    if not is_differential_equation(subject.scene):
        return None, own
    announce("second reference")
    return subject.error(solver_trials.independent_reference(subject)), f"{own}; SciPy's DOP853 at 1e-11"


ASKED = 1e-5, 1e-3
"""Accuracies that the sentence speaks of."""

COMPARED = 1e-5
"""Error at which other tools are compared, where they reach it."""

CHOICES = ("integrators", "communication")
"""Families between whose settings a user of this FMU chooses."""


def cheapest(trials: Iterable[Trial], error: float) -> Trial | None:
    """The fastest trial that is at least so accurate."""
    good = [each for each in trials if each.error is not None and each.error <= error and each.time is not None]
    return min(good, key=lambda each: each.time or 0.0, default=None)


def sentence(study: WorkPrecisionStudy) -> str:
    """What accuracy costs on this scene."""
    ours = [each for each in study.trials if each.family in CHOICES]
    first, second = (cheapest(ours, error) for error in ASKED)
    if first is None or first.time is None:
        return f"No setting reached {ASKED[0]:.0e}."
    text = (
        f"{ASKED[0]:.0e} costs {1e3 * first.time:.1f} ms ({study.duration / first.time:.0f} x real time) with {first.line}, "
        f"{first.label}"
    )
    if second is None or second.time is None:
        return f"{text}."
    same = second is first
    cost = "the same" if same else f"{second.line}, {second.label}: {1e3 * second.time:.1f} ms"
    return f"{text}; the cheapest setting for {ASKED[1]:.0e} is {cost}."


@dataclass(frozen=True)
class Advantage:
    """How much longer another tool takes than ours.

    Attributes:
        error: that both have.
        ratio: its time over ours, each interpolated on the curve of the best settings.
    """

    error: float
    ratio: float


def advantages(study: WorkPrecisionStudy) -> dict[str, Advantage]:
    """Line of another tool → what it takes for an error of `COMPARED`, or for the nearest one that it has reached."""
    tools = study.family("tools")
    curves = {
        line: Curve.of(each for each in tools if each.line == line)
        for line in dict.fromkeys(each.line for each in tools)
    }
    ours, found = curves.pop(OURS, Curve(())), {}
    curves.pop(PAPER_LINE, None)  # our own solver, and the beginning of the motion alone
    for line, curve in curves.items():
        error = min(max(COMPARED, curve.least, ours.least), curve.most)
        own, theirs = ours.time(error), curve.time(error)
        if own and theirs:
            found[line] = Advantage(error, theirs / own)
    return found
