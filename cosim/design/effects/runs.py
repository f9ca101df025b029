"""Runs of a scene as it is, loop included, with different settings: the figures of each, of its neighbours too, and its processor time.

A set of effects or a tolerance may be right by chance, where an error changes its sign. So each setting is also run with a payload that
is a little heavier and a little lighter, and its error is the largest of all three.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import isfinite, nan
from time import process_time
from typing import Any

import numpy as np

from flexfmu.cosim.design.effects.estimator import richest
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.cosim.engine.errors import InputError, LearningWarning, ResultsError
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.results import EVERYTHING
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, LOOP_FIGURES
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.enrichment import FOLLOWING
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

ONCE = {"trajectory.way_back": "none", "trajectory.cycles": 1, "trajectory.pause": 0.0}
"""Changes of a scene that leave a single motion."""

NEIGHBOURS = (0.0, 0.01, -0.01)
"""Relative changes of the payload, or without one of the links' density, with which each setting is run."""

REPETITIONS, ENOUGH = 5, 0.02
"""Most runs that are added to time a setting, and processor time [s] after which none is."""

MARGINS = tuple(name for name in LOOP_FIGURES if name != "cpu_time")
"""Figures of the linear loop, which the numerics of a run don't change."""


def alone(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """The scene with changes, its motors following a single motion exactly."""
    return scene.replace({**FOLLOWING, **ONCE, **changes})


def followed(scene: Scene) -> Trajectory:
    """Return the motion that the motors follow in the estimates: shaped for the richest set, without the way back.

    Raises:
        TrajectoryError: the motion isn't feasible, or can't be shaped.
    """
    if not scene.shaper:
        return plan(scene).joints
    return loop_of(alone(richest(scene), {"shaper": scene.model_dump(exclude_none=True)["shaper"]})).motion.joints


def with_settled(scene: Scene) -> Scene:
    """The scene with settled controllers that learn, see `flexfmu.cosim.design.learning.settled`."""
    if not scene.learners:
        return scene
    from flexfmu.cosim.design.learning import settled  # and with it the linear loop, which few scenes need

    return settled(scene)


def is_smooth(scene: Scene) -> bool:
    """Whether the scene is one smooth equation between breakpoints: motion-driven, nothing in the loop or sampled."""
    is_sampled = any(getattr(each, "apply", "sampled") == "sampled" for each in scene.shaper)
    return scene.cosimulation.drive == "motion" and not (
        scene.controller or scene.imperfection or scene.filter or is_sampled
    )


@dataclass(frozen=True)
class ObservedFigures:
    """Figures of a scene with some settings.

    Attributes:
        values: for each neighbour the figures in SI units, NaN for one without a value.
        time: processor time of a run [s].
    """

    values: tuple[tuple[float, ...], ...]
    time: float

    def change(self, other: ObservedFigures) -> RealArray:
        """Largest change of each figure from another setting's over the neighbours; infinite where one has no value."""
        change = np.abs(np.array(self.values) - np.array(other.values))
        found: RealArray = np.where(np.isnan(change), np.inf, change).max(axis=0)
        return found


class SceneRuns:
    """Runs of a scene with different settings, each made once.

    Args:
        names: the figures, of `ALL_METRICS` and `MARGINS`.
        show: called with the current activity and the finished fraction.
        journal: where figures are kept.
        timed: whether short runs are repeated to time them, and record what the scene says alone.
    """

    def __init__(
        self, names: Collection[str], show: ShowProgress = quiet, journal: WorkJournal = NOWHERE, *, timed: bool = True
    ) -> None:
        self.names, self._timed = tuple(names), timed
        self._metrics = tuple(name for name in names if name in ALL_METRICS)
        self._show, self._journal = show, journal
        self._known: dict[str, ObservedFigures | str] = {}
        self._known_margins: dict[str, dict[str, float]] = {}

    def observe(self, scene: Scene, activity: str = "") -> ObservedFigures:
        """Return the figures of a scene.

        Raises:
            ResultsError: a run failed, or the loop is unstable.
            BuildError, InputError: the FMU can't be built, or the settings don't go together.
        """
        key = scene.model_dump_json(include={"effects", "cosimulation", "payload", "trajectory"})
        if key not in self._known:
            self._show(activity, None)
            self._known[key] = self._journal.kept(key, ObservedFigures | str, lambda: self._observed(scene))
        found = self._known[key]
        if isinstance(found, str):
            raise ResultsError(found)
        return found

    def _observed(self, scene: Scene) -> ObservedFigures | str:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LearningWarning)  # it is given once, of the scene with the chosen settings
            robot = with_settled(scene)
        try:
            prepared = PreparedScene(robot, record=None if self._timed else EVERYTHING)
        except InputError as error:
            return str(error)
        key = "payload.mass" if scene.payload.mass else "mechanism.material.density"
        parameter, value = key.removeprefix("mechanism."), scene.payload.mass or scene.mechanism.material.density
        margins = self._margins(robot)
        rows, times = list[tuple[float, ...]](), list[float]()
        for change in NEIGHBOURS:
            begin = process_time()
            run = prepared.run({parameter: (1.0 + change) * value} if change else {})
            times.append(process_time() - begin)
            if run.outcome is Outcome.INTERRUPTED:
                raise KeyboardInterrupt
            if not run.completed or run.health.unstable_loop:
                return run.health.unstable_loop or run.message
            try:
                measured = measure_run(run, 0, self._metrics)
            except ResultsError as error:
                return str(error)
            values = {**dict(measured), **margins}
            rows.append(tuple(float(values[name]) for name in self.names))  # a metric without a value is NaN
        # short runs again: the first ones have loaded everything
        while self._timed and len(times) < len(NEIGHBOURS) + REPETITIONS and sum(times) < ENOUGH:
            begin = process_time()
            prepared.run()
            times.append(process_time() - begin)
        return ObservedFigures(tuple(rows), min(times))

    def _margins(self, scene: Scene) -> dict[str, float]:
        """The margins of a scene, which its numerics don't change."""
        wanted, key = (
            [name for name in self.names if name in MARGINS],
            scene.model_dump_json(include={"effects", "payload"}),
        )
        if wanted and key not in self._known_margins:
            worst = scene_margins(scene).worst
            values = {name: float(getattr(worst, name)) for name in wanted}
            self._known_margins[key] = {name: each if isfinite(each) else nan for name, each in values.items()}
        return self._known_margins.get(key, {})
