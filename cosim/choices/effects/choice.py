"""Chooses a scene's effects by estimates and verifies the choice by runs.

A run of the chosen set's FMU is compared with the estimates, and where these leave doubt with a run of the richest
set's FMU.
"""

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
"""Metrics of a choice where neither scene nor command line names any; the last one needs a dwell."""

ShowProgress = Callable[[str, float | None], None]
"""Called with the current activity and the finished fraction, 0..1; None where it isn't known."""


def quiet(text: str, fraction: float | None) -> None:
    """Show no progress."""


def requirements(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = ()
) -> tuple[float, tuple[MeasureName, ...]]:
    """Return tolerance and metrics of a choice: the arguments, else the scene's, else the defaults.

    Raises:
        SceneError: a metric can't be estimated or needs a dwell, or the tolerance is out of range.
    """
    dwells = scene.trajectory.dwell > 0.0
    usual = tuple(name for name in MEASURED if dwells or not name.startswith("residual"))
    names = tuple(_measure(name, dwells) for name in of) or scene.effects.of or usual
    value = tolerance if tolerance is not None else scene.effects.tolerance or DEFAULT_TOLERANCE
    if not SMALLEST <= value <= LARGEST:
        raise SceneError(f"the tolerance must be between {SMALLEST:g} and {LARGEST:g} (relative error), got {value:g}")
    return value, tuple(dict.fromkeys(names))


def named_metrics(scene: Scene, of: tuple[str, ...] = ()) -> tuple[MeasureName, ...]:
    """Return the metrics that the user has named: the arguments, else the scene's; none where the defaults apply."""
    return requirements(scene, of=of)[1] if of or scene.effects.of else ()


def _measure(name: str, dwells: bool) -> MeasureName:
    """Check the name of a metric and return it.

    Raises:
        SceneError: the metric can't be estimated, or needs a dwell.
    """
    for known in MEASURES:
        if name == known and (dwells or not name.startswith("residual")):
            return known
    if name in MEASURES:
        raise SceneError(f"{name} needs a standstill after the motion: give the scene a `trajectory.dwell` above 0 s")
    raise SceneError(f"effects can't be chosen by {name!r}: choose from {', '.join(MEASURES)}")


FmuOf = Callable[[Scene], Path]
"""Scene → path of an FMU with its effects."""

EXACT = 1e-9
"""Tolerance of the FMUs in comparisons, small enough that only the effects differ."""

ALLOWED = 0.8
"""Largest observed error in units of the tolerance; the rest is a margin for the error of the richest set,
`CONVERGED`."""

ROUNDS = 6
"""Largest number of choices, each with larger safety factors than the one before; then the richest set is taken."""


@dataclass(frozen=True)
class Observed:
    """Metrics of a run, and a function that repeats the run."""

    metrics: Mapping[MeasureName, float]
    run: Callable[[], object]


def resolved(scene: Scene, show: ShowProgress = quiet) -> Scene:
    """Return the scene with chosen effects if it has ``select = "auto"``, otherwise the scene itself.

    The choice is made for one unshaped motion, without the way back, which the motors follow exactly.

    Raises:
        BuildError: an FMU for the verification can't be built.
        ResultsError: a run failed.
        SceneError: the tolerance or a metric is impossible.
        TrajectoryError: the motion isn't feasible.
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
    """Return the scene with the cheapest set of effects whose error is within the tolerance, and the estimator.

    A run of the chosen set is compared with the estimates. Where they leave doubt, a run of the richest set decides.
    Where its metrics contradict the estimates, the choice is repeated with larger safety factors. Where only the
    integrator's error is too large, its tolerance is tightened, if the choice has set it.

    Args:
        scene: robot, loads and motion; its own elastic effects are ignored.
        motion: the planned motion of its motors.
        tolerance: largest relative error of the metrics.
        of: the metrics.
        named: metrics that the user named, whose errors are relative to their own values, see `scales`.
        show: called with the current activity and the finished fraction.
        fmu_of: function that returns the FMUs; None builds them or takes them from the cache.

    Raises:
        BuildError: an FMU can't be built.
        ResultsError: a run failed.
    """
    show("choosing the effects", None)
    estimator = Estimator(scene, motion, of, named, rich_enough(scene, motion, tolerance, of, named))
    # choose, verify by runs, and increase the safety factors of metrics whose estimates were wrong
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
    """Tighten the integrator's tolerance until the errors are within the tolerance; keep one that the user has set."""
    automatic = scene.cosimulation.tolerance == integrator_tolerance(tolerance)
    while automatic and scene.cosimulation.tolerance > LEAST_TOLERANCE:
        tighter = max(0.1 * scene.cosimulation.tolerance, LEAST_TOLERANCE)
        scene = scene.replace({"cosimulation.tolerance": tighter})
        if max(runs.errors(scene).values()) <= ALLOWED * tolerance:
            break
    return scene


class _Runs:
    """Compares runs of sets of effects with estimates and with the richest set's run, made when first needed."""

    def __init__(
        self, estimator: Estimator, of: tuple[MeasureName, ...], show: ShowProgress, fmu_of: FmuOf | None
    ) -> None:
        self._estimator, self._of, self._show, self._fmu_of = estimator, of, show, fmu_of

    def agree(self, scene: Scene, limit: float) -> bool:
        """Whether a set's errors are within a limit, by its run and the estimates, in doubt by the richest run."""
        self._show("running the chosen set", None)
        own, estimator = observe(scene, self._of, self._fmu_of).metrics, self._estimator
        beside = [
            _errors(own, each, estimator.scales) for each in (estimator.metrics(scene.effects), estimator.reference)
        ]
        # the estimate of the richest set may be as wrong as that of the chosen one, so both differences count
        if all(beside[0][name] + beside[1][name] <= limit for name in self._of):
            return True
        return max(_errors(own, self._richest, self._scales).values()) <= limit

    def errors(self, scene: Scene, tolerance: float | None = None) -> MetricValues:
        """Return a set's errors against the richest set's run, with a tolerance of the FMU or the scene's own."""
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
    """Return the differences of metrics relative to their scales."""
    return {name: abs(value - other[name]) / units[name] for name, value in metrics.items()}


def observe(
    scene: Scene, of: tuple[MeasureName, ...], fmu_of: FmuOf | None = None, tolerance: float | None = None
) -> Observed:
    """Run one motion of a scene without controllers, shapers and imperfections, as the estimates assume; return the metrics.

    Args:
        scene: with chosen effects.
        of: the metrics.
        fmu_of: function that returns its FMU; None builds it or takes it from the cache.
        tolerance: of the FMU; the scene's own when None.

    Raises:
        ResultsError: the run failed.
    """
    alone = {"controller": [], "shaper": [], "imperfection": [], "filter": [], "cosimulation.drive": "motion"}
    bare = scene.replace({**alone, "trajectory.way_back": "none", "trajectory.cycles": 1, "trajectory.pause": 0.0})
    path = (fmu_of or _built)(bare)
    prepared = PreparedScene(bare, fmu_path=path, tolerance=tolerance)
    run = prepared.run()
    if not run.completed:
        raise ResultsError(f"the comparison with {scene.name} failed: {run.message}")
    measured = measure_run(run, companions=0)
    values = {name: measured[name].value for name in of}
    return Observed({name: value for name, value in values.items() if value is not None}, prepared.run)


def _built(scene: Scene) -> Path:
    """Build the FMU that all scenes with the same set share: without estimates, and with the payload as a parameter."""
    return build_scene(scene.replace({"effects.choice": None, "payload.mass": 1.0})).path
