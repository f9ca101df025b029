"""Chooses a scene's effects by estimates and verifies the choice by runs.

The scene is run as it is, with its shapers, controllers, imperfections and disturbances, with the chosen set and with the richest
one. Estimates alone don't decide: they are of motors that follow the motion exactly, and off by a quarter where a residual vibration
is a thousandth of the deflection.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from math import inf
from typing import get_args

from flexfmu.cosim.design.effects.accuracy import MEASURED, accuracy_answer, with_answer
from flexfmu.cosim.design.effects.estimator import Estimator, MetricValues, scales
from flexfmu.cosim.design.effects.runs import ONCE, alone, followed, with_settled
from flexfmu.cosim.design.effects.search import SAFETY, choose_effects, one_more, rich_enough
from flexfmu.cosim.engine.errors import CosimError, LearningWarning, ResultsError
from flexfmu.cosim.engine.results import EVERYTHING
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.accuracy import AccuracyAnswer
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.choice import (
    DEFAULT_TOLERANCE,
    INTEGRATOR_SHARE,
    LARGEST,
    MEASURES,
    SMALLEST,
    MeasureName,
    integrator_tolerance,
)
from flexfmu.model.scene.effects import FamilyName
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory


def requirements(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = ()
) -> tuple[float, tuple[MeasureName, ...]]:
    """Return tolerance and metrics of a choice: the arguments, else the scene's, else the defaults.

    Raises:
        SceneError: a metric can't be estimated or needs a dwell, or the tolerance is out of range.
    """
    dwells, known = scene.trajectory.dwell > 0.0, {str(name): name for name in MEASURES}
    usual = tuple(name for name in MEASURED if dwells or not name.startswith("residual"))
    for name in of:
        if name not in known:
            raise SceneError(f"effects can't be chosen by {name!r}: choose from {', '.join(MEASURES)}")
        if name.startswith("residual") and not dwells:
            raise SceneError(
                f"{name} needs a standstill after the motion: give the scene a `trajectory.dwell` above 0 s"
            )
    names = tuple(known[name] for name in of) or scene.effects.of or usual
    value = tolerance if tolerance is not None else scene.effects.tolerance or DEFAULT_TOLERANCE
    if not SMALLEST <= value <= LARGEST:
        raise SceneError(f"the tolerance must be between {SMALLEST:g} and {LARGEST:g} (relative error), got {value:g}")
    return value, tuple(dict.fromkeys(names))


def named_metrics(scene: Scene, of: tuple[str, ...] = ()) -> tuple[MeasureName, ...]:
    """Return the metrics that the user has named: the arguments, else the scene's; none where the defaults apply."""
    return requirements(scene, of=of)[1] if of or scene.effects.of else ()


EXACT = 1e-9
"""Tolerance of the FMUs in comparisons, small enough that only the effects differ."""

NUMERICAL = 0.2
"""Largest integration error of a verified choice in units of the tolerance: a companion states four times the error of a run, so
that the error beside a metric is within the tolerance. Also the largest change of the richest set by one more mode of every family,
where runs say it. With the share of the effects, half the tolerance, a margin is left."""

ROUNDS = 6
"""Largest number of choices, each with larger safety factors than the one before; then the richest set is taken."""

WITHOUT_ERROR = 1e12
"""Safety factor with which only the richest set is within a tolerance."""


@dataclass(frozen=True)
class Observed:
    """Metrics of a run, and a function that repeats the run."""

    metrics: Mapping[MeasureName, float]
    run: Callable[[], object]


def resolved(scene: Scene, show: ShowProgress = quiet) -> Scene:
    """Return the scene with what it leaves open chosen, see `resolved_with_answer`."""
    return resolved_with_answer(scene, show)[0]


def resolved_with_answer(scene: Scene, show: ShowProgress = quiet) -> tuple[Scene, AccuracyAnswer | None]:
    """Return the scene with chosen effects if it has ``select = "auto"``, with chosen settings if it has ``[accuracy]``.

    Controllers that learn are settled, see `flexfmu.cosim.design.learning.settled`. The answer is that to ``[accuracy]``.

    Raises:
        BuildError: an FMU for the verification can't be built.
        InputError: learning can't be settled, or what ``[accuracy]`` asks for is no figure of the scene.
        ResultsError: a run failed.
        SceneError: the tolerance or a metric is impossible.
        TrajectoryError: the motion isn't feasible.
    """
    answer = None
    if scene.accuracy:
        answer = accuracy_answer(scene, show)
        scene = with_answer(scene, answer)
    if scene.effects.select is not None:
        tolerance, of = requirements(scene)
        scene = choose_verified(scene, followed(scene), tolerance, of, named_metrics(scene), show)[0]
    if scene.learners:
        show("judging what is learned from cycle to cycle", None)
    return with_settled(scene), answer


@one_blas_thread()
def choose_verified(
    scene: Scene,
    motion: Trajectory,
    tolerance: float,
    of: tuple[MeasureName, ...],
    named: Collection[MeasureName] = (),
    show: ShowProgress = quiet,
    journal: WorkJournal = NOWHERE,
) -> tuple[Scene, Estimator]:
    """Return the scene with the cheapest set of effects whose error is within the tolerance, and the estimator.

    Runs of the scene with the chosen set and with the richest one verify the choice. Where they contradict the estimates, the choice
    is repeated with larger safety factors. Where the integrator's error is too large, its tolerance is tightened, if the choice
    has set it. The scene's ``effects.choice`` has the errors of the last run.

    Args:
        scene: robot, loads and motion; its own elastic effects are ignored.
        motion: the planned motion of its motors, for the estimates.
        tolerance: largest relative error of the metrics.
        of: the metrics.
        named: metrics that the user named, whose errors are relative to their own values, see `scales`.
        show: called with the current activity and the finished fraction.
        journal: where the metrics of estimates and runs are kept.

    Raises:
        BuildError: an FMU can't be built.
        ResultsError: a run failed.
    """
    show("choosing the effects", None)
    most = rich_enough(scene, motion, tolerance, of, named, journal)
    estimator = Estimator(scene, motion, of, named, most, journal)
    first, runs = estimator, _Runs(estimator, of, show, journal)
    # where estimates are off, they don't tell how many modes the richest set needs: add some until runs agree
    is_open = runs.contradict_estimates(tolerance)
    while is_open and (most := one_more(estimator.richest, get_args(FamilyName))) != estimator.richest:
        before, estimator = runs, Estimator(scene, motion, of, named, most, journal)
        runs = _Runs(estimator, of, show, journal)
        is_open = runs.change_from(before) > NUMERICAL * tolerance
    # choose, verify by runs, and increase the safety factors of metrics whose estimates were wrong; sets within the first richest one
    # may be small enough
    safety = dict.fromkeys(of, SAFETY)
    for estimates in (first, *(estimator for _ in range(1, ROUNDS))):
        chosen = choose_effects(scene, motion, tolerance, of, estimates, safety)
        exact, estimated = runs.errors(chosen, EXACT), estimates.errors(chosen.effects)
        wrong = [name for name in of if exact[name] > (1.0 - INTEGRATOR_SHARE) * tolerance]
        if not wrong:
            return runs.verified(chosen, tolerance), estimator
        for name in wrong:
            grown = SAFETY * exact[name] / max(estimated[name], 1e-12)
            safety[name] = min(max(2.0 * safety[name], grown), WITHOUT_ERROR)
    everything = choose_effects(scene, motion, tolerance, of, estimator, dict.fromkeys(of, WITHOUT_ERROR))
    return runs.verified(everything, tolerance), estimator


class _Runs:
    """Compares runs of a scene with sets of effects with the run of the richest set, the scene as it is.

    Where the loop's run fails, or nothing controls the torques, the motors follow the motion instead.
    """

    def __init__(
        self, estimator: Estimator, of: tuple[MeasureName, ...], show: ShowProgress, journal: WorkJournal = NOWHERE
    ) -> None:
        self._of, self._show, self._estimator, self._journal = of, show, estimator, journal
        self._known: dict[tuple[str, float], MetricValues] = {}
        show("running the richest set", None)
        needed, most = (*of, "peak_position_error"), estimator.richest
        self._is_alone = most.cosimulation.drive == "torque" and not most.controller
        try:
            self._richest = self._observed(most, needed, EXACT)
        except CosimError:
            self._is_alone = True
            self._richest = self._observed(most, needed, EXACT)
        self._scales = scales(self._richest, estimator.named)

    def contradict_estimates(self, tolerance: float) -> bool:
        """Whether the richest set's run is further than a tolerance from its estimate, of motors that follow the motion exactly."""
        if self._estimator.richest.controller and not self._is_alone:
            return False
        estimated = self._estimator.reference
        return any(abs(self._richest[name] - estimated[name]) > tolerance * self._scales[name] for name in self._of)

    def change_from(self, other: _Runs) -> float:
        """Return the largest change of a metric of the richest set from that of other runs, relative to its scale."""
        return max(abs(self._richest[name] - other._richest[name]) / self._scales[name] for name in self._of)

    def errors(self, scene: Scene, tolerance: float | None = None, beside: MetricValues | None = None) -> MetricValues:
        """Return a set's errors beside the richest set's metrics or others, infinite where its run fails.

        Args:
            scene: with the set.
            tolerance: of the FMU; the scene's own when None.
            beside: metrics to compare with; the richest set's when None.
        """
        other, own = self._richest if beside is None else beside, self._metrics(scene, tolerance)
        return {name: abs(own[name] - other[name]) / self._scales[name] for name in self._of}

    def verified(self, scene: Scene, tolerance: float) -> Scene:
        """Return the scene with its verified errors, the integrator's tolerance tightened unless the user has set it."""
        exact, section = self._metrics(scene, EXACT), scene.cosimulation
        is_free = section.tolerance == integrator_tolerance(tolerance) and not section.integrator_step
        while is_free and max(self.errors(scene, None, exact).values()) > NUMERICAL * tolerance:
            if scene.cosimulation.tolerance <= EXACT:
                break
            scene = scene.replace({"cosimulation.tolerance": max(0.1 * scene.cosimulation.tolerance, EXACT)})
        errors = self.errors(scene)
        if max(errors.values()) == inf:
            observe(scene, self._of, is_alone=self._is_alone)  # says why it fails
        found = {
            "verified": [errors[name] for name in self._of],
            "verified_in": "motion" if self._is_alone else "scene",
        }
        return scene.replace({f"effects.choice.{key}": value for key, value in found.items()})

    def _metrics(self, scene: Scene, tolerance: float | None) -> MetricValues:
        effects = scene.effects.model_copy(update={"choice": None})
        key = effects.model_dump_json(), tolerance or scene.cosimulation.tolerance
        if key not in self._known:
            self._show("running the chosen set", None)
            self._known[key] = self._observed(scene, self._of, tolerance, fails=True)
        return self._known[key]

    def _observed(
        self, scene: Scene, of: tuple[MeasureName, ...], tolerance: float | None, *, fails: bool = False
    ) -> MetricValues:
        """The metrics of a run, from the journal if it has them; where it ``fails``, they may be infinite. Errors as for `observe`."""

        def found() -> MetricValues:
            try:
                return observe(scene, of, tolerance, is_alone=self._is_alone).metrics
            except ResultsError:
                if not fails:
                    raise
                return dict.fromkeys(of, inf)

        own = scene.effects.model_dump_json(exclude={"choice"}), scene.cosimulation.tolerance
        return self._journal.kept(("run", *own, tolerance, self._is_alone, *of), dict[MeasureName, float], found)


def observe(
    scene: Scene, of: tuple[MeasureName, ...], tolerance: float | None = None, *, is_alone: bool = False
) -> Observed:
    """Run a scene and return its metrics.

    References for the flexible robot are left out: they make the error of the path vanish, each for its own set of effects.

    Args:
        scene: with chosen effects.
        of: the metrics.
        tolerance: of the FMU, in place of a fixed integrator step too; the scene's own when None.
        is_alone: whether the motors follow one motion exactly, as the estimates assume, without controllers, shapers,
            imperfections, disturbances and the way back.

    Raises:
        ResultsError: the run failed, or its loop is unstable.
    """
    changes = {"trajectory.references": None} | ({} if tolerance is None else {"cosimulation.integrator_step": 0.0})
    robot = alone(scene, changes) if is_alone else scene.replace(changes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LearningWarning)  # it is given once, of the scene with the chosen set
        robot = with_settled(robot)
    # the FMU that all scenes with the same set share: payload and motion are its parameters and inputs
    shared = {
        "effects.choice": None,
        "cosimulation.tolerance": 1e-4,
        "trajectory.duration": 1.0,
        "trajectory.dwell": 0.0,
        **({} if robot.disturbance else {"payload.mass": 1.0}),
    }
    fmu = build_scene(robot.replace({**shared, **ONCE})).path
    prepared = PreparedScene(robot, fmu_path=fmu, tolerance=tolerance, record=EVERYTHING)
    run = prepared.run()
    if not run.completed or run.health.unstable_loop:
        raise ResultsError(f"the comparison with {scene.name} failed: {run.health.unstable_loop or run.message}")
    measured = measure_run(run, companions=0)
    values = {name: measured[name].value for name in of}
    return Observed({name: value for name, value in values.items() if value is not None}, prepared.run)
