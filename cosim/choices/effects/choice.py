"""A choice of effects that runs have confirmed: what is required, and the chosen set's FMU beside the estimates, and beside the
richest FMU in doubt."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from flexfmu.cosim.choices.effects.estimator import Estimator, MetricValues, scales
from flexfmu.cosim.choices.effects.search import SAFETY, choose_effects, rich_enough
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.choice import (
    DEFAULT_TOLERANCE,
    INTEGRATOR_SHARE,
    LARGEST,
    MEASURES,
    SMALLEST,
    MeasureName,
    integrator_tolerance,
)
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.selection.motion_grid import JointMotion

MEASURED: tuple[MeasureName, ...] = ("peak_position_error", "peak_torque_1", "residual_vibration_amplitude")
"""Metrics that are looked at where neither scene nor command names any; the last one needs a dwell."""

ShowProgress = Callable[[str, float | None], None]
"""Called with what is being done and the finished fraction, 0..1; None where it isn't known."""


def quiet(text: str, fraction: float | None) -> None:
    """No progress."""


def requirements(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = ()
) -> tuple[float, tuple[MeasureName, ...]]:
    """Tolerance and metrics of a choice: the arguments, or the scene's, or the defaults.

    Raises:
        SceneError: a metric can't be estimated, needs a dwell, or the tolerance is out of range.
    """
    dwells = scene.trajectory.dwell > 0.0
    usual = tuple(name for name in MEASURED if dwells or not name.startswith("residual"))
    names = tuple(_measure(name, dwells) for name in of) or scene.effects.of or usual
    value = tolerance if tolerance is not None else scene.effects.tolerance or DEFAULT_TOLERANCE
    if not SMALLEST <= value <= LARGEST:
        raise SceneError(f"the tolerance must be between {SMALLEST:g} and {LARGEST:g} (relative error), got {value:g}")
    return value, tuple(dict.fromkeys(names))


def named_metrics(scene: Scene, of: tuple[str, ...] = ()) -> tuple[MeasureName, ...]:
    """The metrics that the user has named: the arguments, or the scene's; none where the defaults hold."""
    return requirements(scene, of=of)[1] if of or scene.effects.of else ()


def _measure(name: str, dwells: bool) -> MeasureName:
    for known in MEASURES:
        if name == known and (dwells or not name.startswith("residual")):
            return known
    if name in MEASURES:
        raise SceneError(f"{name} needs a standstill after the motion: give the scene a `trajectory.dwell` above 0 s")
    raise SceneError(f"effects can't be chosen by {name!r}: choose from {', '.join(MEASURES)}")


FmuOf = Callable[[Scene], Path]
"""Scene → an FMU with its effects."""

EXACT = 1e-9
"""Tolerance of the FMUs in comparisons, so that the effects alone make the difference."""

ALLOWED = 0.8
"""Largest observed error in tolerances: the richest set itself may be a tenth off."""

ROUNDS = 6
"""Choices, each more careful than the one before, until the richest set is taken."""


@dataclass(frozen=True)
class Observed:
    """Metrics of a run, and the run, to be repeated."""

    metrics: Mapping[MeasureName, float]
    run: Callable[[], object]


def resolved(scene: Scene, show: ShowProgress = quiet) -> Scene:
    """The scene with its effects chosen, if it says ``select = "auto"``; otherwise the scene as it is.

    The choice is made along the scene's own motion, before any shaping, with motors that follow it exactly.

    Raises:
        BuildError: an FMU that the choice is verified by can't be built.
        ResultsError: its run failed.
        TrajectoryError: that motion isn't feasible.
    """
    if scene.effects.select is None:
        return scene
    tolerance, of = requirements(scene)
    return choose_verified(scene, plan(scene).joints, tolerance, of, named_metrics(scene), show)[0]


def choose_verified(
    scene: Scene,
    motion: JointMotion,
    tolerance: float,
    of: tuple[MeasureName, ...],
    named: Collection[MeasureName] = (),
    show: ShowProgress = quiet,
    fmu_of: FmuOf | None = None,
) -> tuple[Scene, Estimator]:
    """The scene with the cheapest set of effects whose error is within the tolerance, and the estimator.

    A run of the chosen set shows how far its metrics are from the estimates. Where that leaves doubt, a run of the richest set
    decides; and where that one contradicts, the choice is made again with estimates that are as much more careful. An integrator's
    tolerance that the choice itself has set is tightened where it is to blame.

    Args:
        scene: robot, loads and motion; its own choice of elastic effects doesn't matter.
        motion: the planned motion of its motors.
        tolerance: largest relative error of the metrics.
        of: the metrics.
        named: those of them that the user named, which are judged relative to themselves.
        show: called with what is being done and the finished fraction.
        fmu_of: where the FMUs come from; built, or taken from the cache, when None.

    Raises:
        BuildError: an FMU can't be built.
        ResultsError: a run failed.
    """
    show("choosing the effects", None)
    estimator = Estimator(scene, motion, of, named, rich_enough(scene, motion, tolerance, of, named))
    # runs judge the estimates, which become more careful where they were wrong
    runs, safety = _Runs(estimator, of, show, fmu_of), dict.fromkeys(of, SAFETY)
    for _ in range(ROUNDS):
        chosen = choose_effects(scene, motion, tolerance, of, estimator, safety)
        if runs.agree(chosen, ALLOWED * tolerance):
            return chosen, estimator
        exact, estimated = runs.errors(chosen, EXACT), estimator.errors(chosen.effects)
        wrong = [name for name in of if exact[name] > (1.0 - INTEGRATOR_SHARE) * tolerance]
        if not wrong:
            return _tightened(chosen, tolerance, runs), estimator
        for name in wrong:
            safety[name] = max(2.0 * safety[name], SAFETY * exact[name] / max(estimated[name], 1e-12))
    return choose_effects(scene, motion, tolerance, of, estimator, dict.fromkeys(of, 1e12)), estimator


def _tightened(scene: Scene, tolerance: float, runs: _Runs) -> Scene:
    """The scene with an integrator's tolerance that keeps the errors within the tolerance, where the choice may set it."""
    automatic = scene.cosimulation.tolerance == integrator_tolerance(tolerance)
    while automatic and scene.cosimulation.tolerance > LEAST_TOLERANCE:
        tighter = max(0.1 * scene.cosimulation.tolerance, LEAST_TOLERANCE)
        scene = scene.replace({"cosimulation.tolerance": tighter})
        if max(runs.errors(scene).values()) <= ALLOWED * tolerance:
            break
    return scene


class _Runs:
    """Runs of sets of effects beside estimates, and beside the richest set's, which is run when first needed."""

    def __init__(
        self, estimator: Estimator, of: tuple[MeasureName, ...], show: ShowProgress, fmu_of: FmuOf | None
    ) -> None:
        self._estimator, self._of, self._show, self._fmu_of = estimator, of, show, fmu_of

    def agree(self, scene: Scene, limit: float) -> bool:
        """Whether a set's errors are within a limit, by its run and the estimates where these leave no doubt."""
        self._show("running the chosen set", None)
        own, estimator = observe(scene, self._of, self._fmu_of).metrics, self._estimator
        beside = [
            _errors(own, each, estimator.scales) for each in (estimator.metrics(scene.effects), estimator.reference)
        ]
        # the richest set's estimate may be as wrong as the chosen one's
        if all(beside[0][name] + beside[1][name] <= limit for name in self._of):
            return True
        return max(_errors(own, self._richest, self._scales).values()) <= limit

    def errors(self, scene: Scene, tolerance: float | None = None) -> MetricValues:
        """Values of a set, beside the richest one, with the FMU's tolerance or the scene's own."""
        own = observe(scene, self._of, self._fmu_of, tolerance).metrics
        return _errors(own, self._richest, self._scales)

    @cached_property
    def _richest(self) -> MetricValues:
        self._show("running the richest set", None)
        return observe(self._estimator.richest, (*self._of, "peak_position_error"), self._fmu_of, EXACT).metrics

    @property
    def _scales(self) -> MetricValues:
        return scales(self._richest, self._estimator.named)


def _errors(metrics: MetricValues, other: MetricValues, units: MetricValues) -> MetricValues:
    """Differences of metrics relative to their scales."""
    return {name: abs(value - other[name]) / units[name] for name, value in metrics.items()}


def observe(
    scene: Scene, of: tuple[MeasureName, ...], fmu_of: FmuOf | None = None, tolerance: float | None = None
) -> Observed:
    """Metrics of a scene's run without its controllers, shapers and imperfections, as the estimates are made.

    Args:
        scene: with its effects chosen.
        of: the metrics.
        fmu_of: where its FMU comes from; built, or taken from the cache, when None.
        tolerance: of the FMU; the scene's own when None.

    Raises:
        ResultsError: the run failed, or a metric doesn't exist.
    """
    bare = scene.replace({"controller": [], "shaper": [], "imperfection": [], "cosimulation.drive": "motion"})
    path = (fmu_of or _built)(bare)
    prepared = PreparedScene(bare, fmu_path=path, tolerance=tolerance)
    run = prepared.run()
    if not run.completed:
        raise ResultsError(f"the comparison with {scene.name} failed: {run.message}")
    measured = measure_run(run, companions=0)
    values = {name: measured[name].value for name in of}
    return Observed({name: value for name, value in values.items() if value is not None}, prepared.run)


def _built(scene: Scene) -> Path:
    """The scene's FMU; what was estimated isn't part of it, and payloads are parameters: all choices of one set share it."""
    return build_scene(scene.replace({"effects.choice": None, "payload.mass": 1.0})).path
