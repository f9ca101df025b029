"""Estimates the metrics of a scene's motion for any set of effects from the equations, without an FMU.

A set of effects is the richest robot without some of its coordinates, so its small elastic motions follow from rows and
columns of the richest robot's matrices, which are evaluated once along the motion. Their response to the loads of the
rigid motion (Duhamel's integral, step by step) enters the exact nonlinear outputs. A sharp estimate adds the linear
response to the residual forces of the linear motion: one Newton iteration for the whole motion at once (waveform
Newton; White and Sangiovanni-Vincentelli, Relaxation Techniques for the Simulation of VLSI Circuits, 1987). Families
that deflect statically are added by the mode acceleration method.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np

from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.model.scene.choice import MeasureName
from flexfmu.model.scene.effects import CHOOSABLE, Effects, FamilyName
from flexfmu.model.scene.schema import Scene
from flexfmu.model.selection.linearized_motion import LinearizedMotion, Outputs
from flexfmu.model.selection.response import ElasticMotion, MotionGrid, motion_grid
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

MetricValues = Mapping[MeasureName, float]
"""Metric → value in SI units, or error relative to the metric's scale."""


RICHEST: Mapping[str, Any] = {
    "proximal_bending": 3,
    "proximal_axial": 1,
    "distal_bending": 2,
    "distal_axial": 1,
    "beam": "timoshenko",
    "foreshortening": True,
    "quasi_static": [],
}
"""Richest set of effects, as keys of the scene's `effects`. One more mode of each family changes no metric of the
paper's scenes by 1e-3, see ``tests/model/selection/test_selection.py``."""

_REQUEST: Mapping[str, Any] = {"select": None, "tolerance": None, "of": None, "choice": None}


def with_set(scene: Scene, chosen: Mapping[str, Any]) -> Scene:
    """Return the scene with this set of effects, other choosable keys at their defaults, and no request to choose."""
    values = {key: type(scene.effects).model_fields[key].default for key in CHOOSABLE} | dict(chosen)
    changes = {**values, "basis": "craig-bampton", **_REQUEST}
    return scene.replace({f"effects.{key}": value for key, value in changes.items()})


def richest(scene: Scene) -> Scene:
    """Return the scene with the set `RICHEST`."""
    return with_set(scene, RICHEST)


@dataclass(frozen=True, eq=False)
class SampledSignal:
    """A sampled signal of a motion; see `flexfmu.cosim.metrics.solution.TimeSignal`.

    Attributes:
        time: (N,) instants [s]; the time of a jump appears twice.
        derivatives: order → values (N, c) of a time derivative, for the orders that are known.
    """

    time: RealArray
    derivatives: Mapping[int, RealArray]

    def peak(self) -> Metric:
        """Largest norm at the instants."""
        return Metric(float(np.linalg.norm(self.derivatives[0], axis=1).max()))

    def root_mean_square(self, order: int = 0) -> Metric:
        """Root mean square by the trapezoidal rule."""
        squares = np.sum(self.derivatives[order] ** 2, axis=1)
        return Metric(float(np.sqrt(np.trapezoid(squares, self.time) / (self.time[-1] - self.time[0]))))

    def final(self, order: int = 0) -> Metric:
        """Norm at the last instant."""
        return Metric(float(np.linalg.norm(self.derivatives[order], axis=1)[-1]))


@dataclass(frozen=True, eq=False)
class EstimatedSolution:
    """Estimated motion with a set of effects; methods as in `flexfmu.cosim.metrics.metrics.RecordedSolution`.

    Attributes:
        grid: the instants.
        outputs: outputs of the robot at them.
        rigid: outputs of the rigid robot at them.
        rest: end-effector position of the static equilibrium at the end pose, (2,) [m].
    """

    grid: MotionGrid
    outputs: Outputs
    rigid: Outputs
    rest: RealArray

    def torque(self, joint: int) -> SampledSignal:
        moving = self.grid.moving
        return SampledSignal(self.grid.time[moving], {0: self.outputs.torque[moving, joint - 1 : joint]})

    def path_error(self) -> SampledSignal:
        return SampledSignal(self.grid.time, {0: self.outputs.position - self.rigid.position})

    def path_error_in_motion(self) -> SampledSignal:
        moving = self.grid.moving
        position = (self.outputs.position - self.rigid.position)[moving]
        acceleration = (self.outputs.acceleration - self.rigid.acceleration)[moving]
        return SampledSignal(self.grid.time[moving], {0: position, 2: acceleration})

    def residual_vibration(self) -> SampledSignal | None:
        dwelling = ~self.grid.moving
        if not dwelling.any():
            return None
        distance = np.linalg.norm(self.outputs.position[dwelling] - self.rest, axis=1, keepdims=True)
        return SampledSignal(self.grid.time[dwelling], {0: distance})

    def metrics(self, of: Iterable[MeasureName]) -> dict[MeasureName, float]:
        """Return metrics in SI units.

        Raises:
            ValueError: a metric has no value because there is no dwell.
        """
        found: dict[MeasureName, float] = {}
        for name in of:
            value = METRICS[name].computation(self).value
            if value is None:
                raise ValueError(f"{name} needs a standstill after the motion")
            found[name] = value
        return found


class Estimator:
    """Estimates the metrics of a scene's motion for any set of effects.

    Args:
        scene: robot and loads; its own elastic effects are ignored.
        motion: the planned motion of its motors.
        of: the metrics.
        most: the scene with the richest set, `richest(scene)` when None.
        journal: where estimates are kept.

    Attributes:
        richest: the scene with the richest set.
    """

    def __init__(
        self,
        scene: Scene,
        motion: Trajectory,
        of: tuple[MeasureName, ...],
        most: Scene | None = None,
        journal: WorkJournal = NOWHERE,
    ) -> None:
        self.richest, self._of = richest(scene) if most is None else most, of
        self._journal = journal
        self._grid: MotionGrid = motion_grid(motion, scene.trajectory.dwell)
        self._static_start = scene.cosimulation.initial == "static"
        self._robots: dict[tuple[str, bool | str], LinearizedMotion] = {}
        self._known: dict[tuple[str, bool], MetricValues] = {}
        # outputs of the rigid robot
        robot = self._robot(self.richest.effects)
        rest = np.zeros(robot.load.shape)
        self._rigid = robot.outputs(ElasticMotion(rest, rest, rest))

    @cached_property
    def reference(self) -> MetricValues:
        """Metrics with the richest set, in SI units."""
        return self.metrics(self.richest.effects)

    @cached_property
    def scales(self) -> MetricValues:
        """What errors are relative to: the metrics' own magnitudes, unless they are `scaled` [SI]."""
        return {name: abs(value) for name, value in self.reference.items()}

    @cached_property
    def largest_deflection(self) -> float:
        """Largest deflection of a link relative to its length, in the linear response of the richest set."""
        robot, mechanism = self._robot(self.richest.effects), self.richest.mechanism
        states = robot.coordinates(self.richest.effects)
        motion = robot.response(states, robot.equilibrium(self._grid.rests[0], states))
        lengths = {"1": mechanism.proximal.length, "2": mechanism.distal.length}
        # the first shapes are the tip's displacement, or that of the middle
        return max(
            float(np.abs(motion.position[:, i]).max()) / lengths[name[5]]
            for i, name in enumerate(robot.names)
            if name.endswith("bending[1]")
        )

    def scaled(self, units: MetricValues) -> Estimator:
        """Return the same estimates, whose errors are relative to these units [SI]."""
        other = copy(self)
        other.__dict__["scales"] = units
        return other

    def metrics(self, effects: Effects, *, sharp: bool = True) -> MetricValues:
        """Return the metrics with a set of effects, in SI units; ``sharp`` adds the Newton iteration."""
        key = effects.model_dump_json(), sharp
        if key not in self._known:
            unit = "estimate", self.richest.effects.model_dump_json(), *key
            self._known[key] = self._journal.kept(
                unit, dict[MeasureName, float], lambda: self._solution(effects, sharp).metrics(self._of)
            )
        return self._known[key]

    def covers(self, effects: Effects) -> bool:
        """Whether the richest set has at least as many modes of every family."""
        most = self.richest.effects
        return all(getattr(effects, family) <= getattr(most, family) for family in get_args(FamilyName))

    def changes(self, effects: Effects, other: Effects, *, sharp: bool = True) -> MetricValues:
        """Return the differences of the metrics between two sets, relative to their scales."""
        first, second = self.metrics(effects, sharp=sharp), self.metrics(other, sharp=sharp)
        return {name: abs(first[name] - second[name]) / self.scales[name] for name in self._of}

    def errors(self, effects: Effects, *, sharp: bool = True) -> MetricValues:
        """Return the differences of the metrics from the richest set's, relative to their scales."""
        return self.changes(effects, self.richest.effects, sharp=sharp)

    def _robot(self, effects: Effects) -> LinearizedMotion:
        """Return the richest robot with beam theory and foreshortening of a set of effects."""
        key = effects.beam, effects.foreshortening
        if key not in self._robots:
            theory = {"effects.beam": effects.beam, "effects.foreshortening": effects.foreshortening}
            self._robots[key] = LinearizedMotion(self.richest.replace(theory), self._grid)
        return self._robots[key]

    def _solution(self, effects: Effects, sharp: bool) -> EstimatedSolution:
        # coordinates of the richest robot that are states of the set, and those that deflect statically
        robot = self._robot(effects)
        states, statics = (robot.coordinates(effects, static=wanted) for wanted in (False, True))
        # linear response; a sharp estimate adds one Newton iteration for the whole motion
        start = robot.equilibrium(self._grid.rests[0], states) if self._static_start else np.zeros(states.size)
        motion = robot.response(states, start)
        if sharp and states.size:
            motion = robot.corrected(motion, states)
        # exact outputs of that motion; static deflections change the end-effector position only
        outputs = robot.outputs(motion)
        if statics.size:
            deflected = replace(motion, position=motion.position + robot.deflections(motion, statics))
            outputs = replace(outputs, position=robot.outputs(deflected).position)
        return EstimatedSolution(
            self._grid, outputs, self._rigid, robot.rest_position(self._grid.rests[1], states, statics)
        )
