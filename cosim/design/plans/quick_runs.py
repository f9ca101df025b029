"""Quick runs of a motion-driven robot: one motion after another, each with all variants of the robot side by side.

Between communication points the joint references are quintic polynomials with the motion's position, velocity and acceleration
at both ends, so that a motion is known by its values at these points alone. They are for comparing motions: with steps of 1 ms
peaks and residual vibrations are found to about 1 %.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import log
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.lockstep import Lockstep, SampledInputs
from flexfmu.cosim.engine.fmu.variables import Value, parameter_names
from flexfmu.cosim.experiment.parameters import parameters_for
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import Jet, RealArray
from flexfmu.trajectories.piecewise import spline

KINDS = ("position", "velocity", "acceleration")
"""Last part of the references' names, by the order of the time derivative."""

OUTPUTS = ("end_effector.position.x", "end_effector.position.y", "joint1.torque", "joint2.torque")
"""The recorded outputs."""

TOLERANCE = 1e-5
"""Relative tolerance of the integrator."""

EVERY = 3
"""Number of variants for each whose track is examined: positions change little and steadily with the payload."""

MIDDLE = np.array([-1.0, 9.0, 9.0, -1.0]) / 16.0
"""Weights of four equidistant values for the position halfway between the second and the third."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joint references at communication points, from the start of the motion to its end.

    Attributes:
        time: (N,) equidistant points from 0 to the duration [s].
        values: (3, N, 2) q11 and q21 [rad], with first and second time derivative.
    """

    time: RealArray
    values: RealArray

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.time[-1])

    @cached_property
    def polynomials(self) -> RealArray:
        """(N - 1, 6, 2) derivatives 0 to 5 at the beginning of the quintic of each step."""
        taylor = spline(self.time, self.values).coefficients
        return np.moveaxis(Jet(taylor).derivatives(), 0, 1)

    @cached_property
    def peaks(self) -> RealArray:
        """(3,) largest speed [rad/s], acceleration [rad/s2] and jerk [rad/s3] of a joint."""
        return np.array([*np.abs(self.values[1:]).max(axis=(1, 2)), np.abs(self.jerks).max()])

    @property
    def jerks(self) -> RealArray:
        """(N - 1, 2) mean jerks of the steps [rad/s3]."""
        return np.asarray(np.diff(self.values[2], axis=0) / (self.time[1] - self.time[0]))


@dataclass(frozen=True, eq=False)
class QuickRun:
    """A run of all V variants.

    Attributes:
        motion: the joint references.
        time: (N,) communication points [s], motion and dwell.
        position: (V, N, 2) end effector [m].
        torque: (V, N, 2) [N.m].
        rest: (V, 2) equilibrium of the end effector at the end pose [m].
    """

    motion: JointMotion
    time: RealArray
    position: RealArray
    torque: RealArray
    rest: RealArray

    @property
    def moving(self) -> int:
        """Number of communication points until the motion's end, included."""
        return len(self.motion.time)

    @cached_property
    def peak_torques(self) -> RealArray:
        """(V, 2) largest torque of each motor over the motion [N.m]."""
        return np.asarray(np.abs(self.torque[:, : self.moving]).max(axis=1))

    @cached_property
    def powers(self) -> RealArray:
        """(V, N, 2) mechanical power of each motor during the motion [W]."""
        return np.asarray(self.torque[:, : self.moving] * self.motion.values[1])

    @cached_property
    def track(self) -> RealArray:
        """(V / `EVERY`, M, 2) positions during the motion [m], and halfway between them by cubics through the four nearest."""
        p = self.position[::EVERY, : self.moving + 2]
        middles = np.einsum("k,kvni->vni", MIDDLE, np.stack([p[:, k : p.shape[1] - 3 + k] for k in range(4)]))
        return np.asarray(np.stack([p[:, 1:-2], middles], axis=2).reshape(len(p), -1, 2))

    def residuals(self, settled_within: float = 0.0) -> RealArray:
        """(V,) largest distance from the equilibrium, from some time [s] after the motion's end on [m]."""
        return np.asarray(np.linalg.norm(self.vibration(settled_within), axis=2).max(axis=1))

    def vibration(self, settled_within: float = 0.0) -> RealArray:
        """(V, M, 2) deviations from the equilibrium from that time on [m]."""
        late = self.time >= self.motion.duration + settled_within - 1e-9
        return np.asarray(self.position[:, late] - self.rest[:, None])


class QuickRobot:
    """A robot that follows motions, with variants of its parameters.

    Args:
        scene: motion-driven scene.
        fmu_path: its FMU.
        variants: changed FMU parameters of each variant.
        rest: (V, 2) equilibria of the end effector where the motions end [m].
        step: longest communication step [s].
        dwell: standstill after a motion [s].
    """

    def __init__(
        self,
        scene: Scene,
        fmu_path: Path,
        variants: Sequence[Mapping[str, float]],
        rest: RealArray,
        step: float,
        dwell: float,
    ) -> None:
        description = open_fmu(fmu_path).description
        settings = parameters_for(scene, parameter_names(description))
        self._path, self._settings = fmu_path, dict[str, Value](settings) | {INITIAL.name: "static"}
        self._rest, self.step, self._dwell = rest, step, dwell
        # the inputs: joint number and order of the derivative of each
        names = [each.name for each in description.modelVariables if each.causality == "input"]
        self._names, self._joints = names, [int(name[5]) - 1 for name in names]
        self._kinds = [KINDS.index(name.rpartition(".")[2]) for name in names]
        # values of the parameters that any variant changes
        self._changed = sorted({name for each in variants for name in each})
        values = [[each.get(name, settings[name]) for name in self._changed] for each in variants]
        self._values = np.array(values, dtype=float).reshape(len(variants), -1)

    def steps(self, duration: float) -> int:
        """Number of communication steps of a motion of this duration [s]."""
        return max(2, int(np.ceil(duration / self.step - 1e-9)))

    def run(self, motion: JointMotion) -> QuickRun:
        """Run all variants.

        Raises:
            CosimError: a variant can't be simulated.
        """
        course = self._course(motion)
        solver = Lockstep(self._path, self._settings, course, self._changed, OUTPUTS, order=0, tolerance=TOLERANCE)
        found, failed = solver.record(self._values)
        if failed.any():
            raise CosimError("a variant of the robot can't follow the motion")
        outputs = np.swapaxes(found[:, :, 0], 1, 2)
        return QuickRun(motion, course.times, outputs[:, :, :2], outputs[:, :, 2:], self._rest)

    def _course(self, motion: JointMotion) -> SampledInputs:
        """The references at communication points, and the standstill after them."""
        late = motion.duration + np.arange(1, int(np.ceil(self._dwell / self.step)) + 1) * self.step
        still = np.zeros((late.size, 6, 2))
        still[:, 0] = motion.values[0, -1]
        joints = np.concatenate([motion.polynomials, still])
        # of each input: derivatives of the joint from its own order on
        inputs = np.zeros((len(joints), 6, len(self._names)))
        for i, (joint, kind) in enumerate(zip(self._joints, self._kinds, strict=True)):
            inputs[:, : 6 - kind, i] = joints[:, kind:, joint]
        before = np.where(np.array(self._kinds) == 0, motion.values[0, 0][self._joints], 0.0)
        times = np.concatenate([motion.time, late])
        jumps = np.zeros(times.size, dtype=bool)
        return SampledInputs(times, jumps, self._names, before, inputs, self._kinds, len(motion.time) - 1)


CLEARANCE = "clearance"
"""Name of the limit on the distance to the keep-out region."""

WORTH = 2.0
"""Weight of exceeded limits: the relative excess counts twice as much as what is minimised, so that no motion gains by exceeding
a limit, since torques fall with the square of the time and residual vibrations faster."""

INSIDE = 1.002
"""Factor of the uses for which motions are improved, so that they end within the limits rather than at them."""

LENGTH = 2e-4
"""Distance [m] beyond the margin that counts as much as a limit exceeded by 100 %."""

_ANGLES = np.arange(16) * np.pi / 8.0
DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)]) / np.cos(np.pi / 16.0)
"""(2, 16) vectors; the largest product of a vector with one of them is 1 to 1.02 times its length."""


@dataclass(frozen=True)
class Bounds:
    """Limits of a search for V variants of the robot.

    Attributes:
        minimise: ``time``, ``torque``, ``energy``, ``residual`` or ``rms_torque``.
        residual: largest residual vibration [m].
        settled_within: time after the motion from which it holds [s].
        torque: (V, 2) largest torque of each motor with each variant [N.m]; infinite without a limit.
        others: name → largest value of each of `Score.loads`, and of speed, acceleration and jerk.
        distance: signed distances (N,) of positions (N, 2) [m] from the keep-out region, negative inside; None without one.
        margin: by how much the end effector may come nearer [m].
        pause: standstill after the motion that RMS torques contain [s].
        passage: how far a way through positions (N, 2) [m] would have to move to go around what it passes through [m].
    """

    minimise: str
    residual: float
    settled_within: float
    torque: RealArray
    others: Mapping[str, RealArray] = field(default_factory=dict)
    distance: Callable[[RealArray], RealArray] | None = None
    margin: float = 0.0
    pause: float = 0.0
    passage: Callable[[RealArray], float] | None = None


@dataclass(frozen=True, eq=False)
class Score:
    """Figures of a motion, the worst of all variants, and what each limit is used of.

    Args:
        run: the run.
        bounds: the limits.
    """

    run: QuickRun
    bounds: Bounds

    @cached_property
    def values(self) -> Mapping[str, float]:
        """``time`` [s], ``residual`` [m], ``torque`` [N.m], all `loads`, and ``speed``, ``acceleration``, ``jerk`` of the joints
        [rad/s ...]."""
        run = self.run
        return {
            "time": run.motion.duration,
            "residual": float(run.residuals(self.bounds.settled_within).max()),
            "torque": float(run.peak_torques.max()),
            **{name: float(each.max()) for name, each in self.loads.items()},
            **dict(zip(("speed", "acceleration", "jerk"), run.motion.peaks.tolist(), strict=True)),
        }

    @cached_property
    def loads(self) -> Mapping[str, RealArray]:
        """``power`` [W] and ``rms_torque`` [N.m] of each variant and motor (V, 2), ``energy`` without what motors take back [J],
        ``supply_power`` and ``regenerated_power`` [W] of both motors (V,)."""
        run, step, pause = self.run, self.run.time[1] - self.run.time[0], self.bounds.pause
        duration, both = run.motion.duration, run.powers.sum(axis=2)
        square = duration * (run.torque[:, : run.moving] ** 2).mean(axis=1) + pause * run.torque[:, -1] ** 2
        return {
            "power": np.abs(run.powers).max(axis=1),
            "rms_torque": np.sqrt(square / (duration + pause)),
            "energy": np.maximum(run.powers, 0.0).sum(axis=(1, 2)) * step,
            "supply_power": np.maximum(both.max(axis=1), 0.0),
            "regenerated_power": np.maximum(-both.min(axis=1), 0.0),
        }

    @cached_property
    def rows(self) -> Mapping[str, RealArray]:
        """Name of each limit → value by limit in all instants, variants and directions; the largest is its use.

        The clearance's is 1 at the margin and 2 at `LENGTH` beyond it. As functions of a design's numbers all are smooth where
        the instants are as many.
        """
        run, bounds = self.run, self.bounds
        found = {"torque": _both((run.torque[:, : run.moving] / bounds.torque[:, None]).ravel())}
        for name, limit in bounds.others.items():
            if name in self.loads and name != "power":
                found[name] = (self.loads[name] / limit).ravel()
            else:
                found[name] = _both((self._rates[name] / (limit[:, None] if name == "power" else limit)).ravel())
        if bounds.minimise != "residual":
            vibration = run.vibration(bounds.settled_within)
            found["residual"] = (vibration @ DIRECTIONS).ravel() / bounds.residual
        if bounds.distance is not None:
            distances = bounds.distance(run.track.reshape(-1, 2))
            if bounds.passage is not None:
                distances = np.append(distances, -max(map(bounds.passage, run.track)))
            found[CLEARANCE] = 1.0 + (-bounds.margin - distances) / LENGTH
        return found

    @cached_property
    def _rates(self) -> Mapping[str, RealArray]:
        speed, acceleration = self.run.motion.values[1:]
        return {"speed": speed, "acceleration": acceleration, "jerk": self.run.motion.jerks, "power": self.run.powers}

    @cached_property
    def uses(self) -> Mapping[str, float]:
        """Name of each limit → what is used of it; 1 is at the limit."""
        return {name: float(rows.max()) for name, rows in self.rows.items()}

    @property
    def feasible(self) -> bool:
        """Whether all limits are kept."""
        return max(self.uses.values()) <= 1.0

    def forget(self) -> None:
        """Drop the rows, which take a megabyte and a few milliseconds to calculate again."""
        for name in ("rows", "minimised", "_rates", "loads"):
            self.__dict__.pop(name, None)

    @cached_property
    def minimised(self) -> RealArray:
        """Values of what is minimised, the largest of which counts: of torque and residual vibration in all instants and variants."""
        bounds, run = self.bounds, self.run
        if bounds.minimise == "residual":
            return np.asarray((run.vibration(bounds.settled_within) @ DIRECTIONS).ravel())
        if bounds.minimise == "torque":
            return _both(run.torque[:, : run.moving].ravel())
        return np.array([self.values[bounds.minimise]])

    @cached_property
    def objective(self) -> float:
        """The logarithm of what is minimised."""
        return log(max(float(self.minimised.max()), 1e-12))

    def cost(self, tighter: Mapping[str, float]) -> float:
        """The objective with exceeded limits added.

        Args:
            tighter: factors of the uses, by default `INSIDE`; 0 for limits that play no part.
        """
        return self.objective + WORTH * sum(
            excess(name, use * tighter.get(name, INSIDE)) for name, use in self.uses.items()
        )


def excess(name: str, use: float) -> float:
    """By how much a limit is exceeded: the logarithm of its use, of the clearance the distance by `LENGTH`."""
    return max(0.0, use - 1.0 if name == CLEARANCE else log(max(use, 1e-12)))


def _both(rows: RealArray) -> RealArray:
    """Rows with both signs."""
    return np.concatenate([rows, -rows])
