"""A choice of effects that runs have confirmed: the chosen set's FMU beside the estimates, and beside the richest FMU in doubt."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from flexfmu.cosim.effects.choice import Step, quiet
from flexfmu.cosim.errors import ResultsError
from flexfmu.cosim.experiment import PreparedScene
from flexfmu.cosim.metrics import measure_run
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.model.choice_section import INTEGRATOR_SHARE, MeasureName, integrator_tolerance
from flexfmu.model.cosimulation_section import LEAST_TOLERANCE
from flexfmu.model.scene import Scene
from flexfmu.model.selection.choose import SAFETY, choose_effects, rich_enough
from flexfmu.model.selection.estimator import Estimator
from flexfmu.model.selection.measures import scales
from flexfmu.model.selection.motion_grid import JointMotion

Values = Mapping[MeasureName, float]
"""Metrics in SI units, or their errors relative to the metrics' scales."""

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


def choose_verified(
    scene: Scene,
    motion: JointMotion,
    tolerance: float,
    of: tuple[MeasureName, ...],
    asked: Collection[MeasureName] = (),
    show: Step = quiet,
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
        asked: those of them that the user named, which are judged relative to themselves.
        show: told what is being done.
        fmu_of: where the FMUs come from; built, or taken from the cache, when None.

    Raises:
        BuildError: an FMU can't be built.
        ResultsError: a run failed.
    """
    show("choosing the effects", None)
    estimator = Estimator(scene, motion, of, asked, rich_enough(scene, motion, tolerance, of, asked))
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

    def __init__(self, estimator: Estimator, of: tuple[MeasureName, ...], show: Step, fmu_of: FmuOf | None) -> None:
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

    def errors(self, scene: Scene, tolerance: float | None = None) -> Values:
        """Values of a set, beside the richest one, with the FMU's tolerance or the scene's own."""
        own = observe(scene, self._of, self._fmu_of, tolerance).metrics
        return _errors(own, self._richest, self._scales)

    @cached_property
    def _richest(self) -> Values:
        self._show("running the richest set", None)
        return observe(self._estimator.richest, (*self._of, "peak_position_error"), self._fmu_of, EXACT).metrics

    @property
    def _scales(self) -> Values:
        return scales(self._richest, self._estimator.asked)


def _errors(metrics: Values, other: Values, units: Values) -> Values:
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
