"""Chooses a scene's effects alone, within a relative error of some figures: the choice of `flexfmu.cosim.design.effects.accuracy` with the
communication step and the integrator of the scene.

The scene is run as it is, with its shapers, controllers, imperfections and disturbances. Half the error is for the effects that are left
out, the rest for the integration: where it is too large, the FMU's tolerance is tightened, unless the user has set it. The bound of
the chooser is what the choice states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flexfmu.cosim.design.effects.accuracy import (
    EXACT_EFFECTS,
    MEASURED,
    WITHOUT_ERROR,
    Chooser,
    NotConvergedError,
    accuracy_answer,
    check_figures,
    with_answer,
)
from flexfmu.cosim.design.effects.estimator import with_set
from flexfmu.cosim.design.effects.runs import ONCE, with_settled
from flexfmu.cosim.design.effects.search import SAFETY, neighbours
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.accuracy import AccuracyAnswer
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.metrics.metric_table import definition
from flexfmu.model.enrichment import FOLLOWING
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.choice import (
    DEFAULT_TOLERANCE,
    INTEGRATOR_SHARE,
    LARGEST,
    NAMED_FLOOR,
    SMALLEST,
    ChoiceSection,
    EstimatedEffect,
    Shares,
    integrator_tolerance,
)
from flexfmu.model.scene.effects import CHOOSABLE
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene

FLOOR = 0.1
"""Smallest scale of a position metric that the user hasn't named, as a fraction of the peak position error: a decayed residual vibration
is near zero and no useful scale."""

NUMERICAL = 0.2
"""Largest integration error of a choice in units of the tolerance: a companion states four times the error of a run, so that the error
beside a metric is within the tolerance. With the share of the effects, half the tolerance, a margin is left."""


def requirements(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = ()
) -> tuple[float, tuple[str, ...]]:
    """Return tolerance and metrics of a choice: the arguments, else the scene's, else the defaults.

    Raises:
        InputError: a metric is none of this robot, or needs a dwell.
        SceneError: the tolerance is out of range.
    """
    usual = tuple(name for name in MEASURED if scene.trajectory.dwell > 0.0 or not name.startswith("residual"))
    names = of or scene.effects.of or usual
    value = tolerance if tolerance is not None else scene.effects.tolerance or DEFAULT_TOLERANCE
    check_figures(scene, dict.fromkeys(names, value), "effects.of")
    if not SMALLEST <= value <= LARGEST:
        raise SceneError(f"the tolerance must be between {SMALLEST:g} and {LARGEST:g} (relative error), got {value:g}")
    return value, tuple(dict.fromkeys(names))


def resolved(scene: Scene, show: ShowProgress = quiet) -> Scene:
    """Return the scene with what it leaves open chosen, see `resolved_with_answer`."""
    return resolved_with_answer(scene, show)[0]


def resolved_with_answer(scene: Scene, show: ShowProgress = quiet) -> tuple[Scene, AccuracyAnswer | None]:
    """Return the scene with chosen effects if it has ``select = "auto"``, with chosen settings if it has ``[accuracy]``.

    Controllers that learn are settled, see `flexfmu.cosim.design.learning.settled`. The answer is that to ``[accuracy]``.

    Raises:
        BuildError: an FMU for the verification can't be built.
        InputError: learning can't be settled, or what is asked for is no figure of the scene.
        ResultsError: a run failed, or a figure doesn't converge with the number of modes.
        SceneError: the tolerance is impossible.
        TrajectoryError: the motion isn't feasible.
    """
    answer = None
    if scene.accuracy:
        answer = accuracy_answer(scene, show)
        scene = with_answer(scene, answer)
    if scene.effects.select is not None:
        scene = choose_effects(scene, show=show).scene
    if scene.learners:
        show("judging what is learned from cycle to cycle", None)
    return with_settled(scene), answer


@dataclass(frozen=True)
class EffectChoice:
    """Chosen effects, and what has chosen them.

    Attributes:
        scene: with the chosen set; ``scene.effects.choice`` has its errors and what each effect is worth.
        chooser: with runs and estimates.
        changes: of the scene in its runs: without references, which make the error of the path vanish, each for its own set of effects;
            where its loop can't run, or nothing controls the torques, its motors follow a single motion exactly.
    """

    scene: Scene
    chooser: Chooser
    changes: Mapping[str, Any]

    @property
    def section(self) -> ChoiceSection:
        """How the effects were chosen: tolerance, metrics, errors and contributions."""
        choice = self.scene.effects.choice
        assert choice is not None  # `choose_effects` sets it
        return choice

    @property
    def scales(self) -> dict[str, float]:
        """What the errors of each metric are relative to [SI]."""
        allowed = dict(zip(self.chooser.asked, self.chooser.allowed.tolist(), strict=True))
        return {name: allowed[name] / self.section.tolerance for name in self.section.of}

    def change(self, first: Scene, second: Scene) -> dict[str, float]:
        """Return the change of each metric between exact runs of two scenes, relative to its scale; errors as for `SceneRuns.observe`."""
        one, other = (self.chooser.exact_figures(self.as_run(each)) for each in (first, second))
        errors = dict(zip(self.chooser.asked, one.change(other).tolist(), strict=True))
        return {name: errors[name] / scale for name, scale in self.scales.items()}

    def as_run(self, scene: Scene) -> Scene:
        """Return a scene of the choice as it is run."""
        return scene.replace({**self.changes, "effects.choice": None})


@one_blas_thread()
def choose_effects(
    scene: Scene,
    tolerance: float | None = None,
    of: tuple[str, ...] = (),
    show: ShowProgress = quiet,
    journal: WorkJournal = NOWHERE,
) -> EffectChoice:
    """Choose the cheapest set of effects whose error is within the tolerance.

    Args:
        scene: robot, loads and motion; its own elastic effects are ignored.
        tolerance, of: largest relative error, of which metrics; the scene's or the defaults, see `requirements`.
        show: called with the current activity and the finished fraction.
        journal: where estimates and runs are kept.

    Raises:
        As `resolved_with_answer`.
    """
    tolerance, names = requirements(scene, tolerance, of)
    show("choosing the effects", None)
    asked = dict.fromkeys(names, tolerance)
    if any(definition(name).unit == "m" for name in names):
        asked.setdefault("peak_position_error", WITHOUT_ERROR)  # to which small ones are compared
    floor = NAMED_FLOOR if of or scene.effects.of else FLOOR
    plain: dict[str, Any] = {"trajectory.references": None}
    alone = {**plain, **FOLLOWING, **ONCE}
    is_alone = scene.cosimulation.drive == "torque" and not scene.controller
    for changes in (alone,) if is_alone else (plain, alone):
        try:
            chooser = Chooser(with_set(scene, {}).replace(changes), asked, show, journal, floor)
            break
        except CosimError as error:
            if changes is alone or isinstance(error, NotConvergedError):
                raise
    chosen = with_set(scene, chooser.smallest(1.0 - INTEGRATOR_SHARE).effects.model_dump(include={*CHOOSABLE}))
    # an integration error that is too large
    section = chosen.cosimulation
    is_free = section.tolerance == integrator_tolerance(tolerance) and not section.integrator_step
    show("running the chosen set", None)
    while True:
        trial = chooser.trial(chosen.replace(changes))
        fits = trial is not None and (trial.numerics <= NUMERICAL * chooser.allowed).all()
        if fits or not is_free or chosen.cosimulation.tolerance <= EXACT_EFFECTS:
            break
        chosen = chosen.replace({"cosimulation.tolerance": max(0.1 * chosen.cosimulation.tolerance, EXACT_EFFECTS)})
    trial = chooser.measured(chosen.replace(changes))  # or why it fails
    # what is stated, in the order of the metrics; estimates don't have all of them
    estimates = chooser.estimates
    total = dict(zip(asked, ((trial.both + chooser.reserve) / chooser.allowed).tolist(), strict=True))

    def relative(values: Mapping[Any, float], factor: float = tolerance) -> Shares:
        return tuple(factor * values[name] if name in values else None for name in names)

    worth = tuple(
        EstimatedEffect(
            effect=each.effect,
            change=each.change,
            chosen=is_chosen,
            contribution=relative(estimates.changes(chosen.effects, each.scene.effects)),
        )
        for each, is_chosen in neighbours(estimates, chosen)
    )
    choice = ChoiceSection(
        tolerance=tolerance,
        of=names,
        error=relative(estimates.errors(chosen.effects), SAFETY * tolerance),
        verified=relative(total),
        verified_in="motion" if changes is alone else "scene",
        effects=worth,
    )
    return EffectChoice(chosen.replace({"effects.choice": choice.model_dump()}), chooser, changes)
