"""Optimal joint references of one motion or of a cycle, within limits that hold for several variants of a robot, by sequential convex
programming.

The first stage has few variants and a loose bound on the residual vibration. Later stages have more variants and the wanted bound. Before each of
them all variants are evaluated on a finer grid: its end state corrects that of the coarse one, the worst variants join the others, and
what still lies between them tightens the limits.

The elastic motion is eliminated: `ElasticResponse` gives torques, end effector and end state of all variants with exact
derivatives. A quadratic programme linearises the limits and finds the step that reduces the duration, or the motors' effort in a given
duration, most, less a penalty on changes of the accelerations that is adapted like a trust region. At the fastest motion about as many
limits are active as there are variables, so that the programmes converge without second derivatives; the effort is a sum of convex
functions of torques or powers, whose curvature they have (Gauss-Newton). Limits that can't be met yet are relaxed at a price (l1
merit function), and further programmes with the limits' values at the new motion correct their curvature (second-order
correction).

All limits are g(x) <= slack of their group, with g relative to the limit, and x = [free coefficients of joint 1, of joint 2, T].
What remains of the vibration is bounded mode by mode: the sum over the modes of modal amplitude at the end of the motion times
displacement of the end effector by the mode. It bounds the free vibration after the motion. The amplitude of a mode, the length of
a vector [place, rate], is bounded by half planes in `DIRECTIONS`.

A cycle has several ways, each with its own robots, first motion and limits: the programmes have the variables of all, and RMS torques and
energies of the whole cycle with its pauses (`Loads`). What a way leaves of vibration decays in the pause after it, the rest
swings on in the next way, and so on round the cycle (`LeftVibration`): the bounds are those of the periodic motion.

Sources: J. Nocedal and S. Wright, *Numerical Optimization*, Springer 2006, sections 15.6 and 18.5; R. Fletcher and E. Sainz de la
Maza, Nonlinear programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43 (1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from flexfmu.model.reference_design.elastic_response import (
    COMPARED,
    LINK_LOADS,
    SHARED,
    ElasticResponse,
    Rest,
    RobotVariant,
    VariantModel,
    joined,
)
from flexfmu.model.reference_design.joint_spline import DesignedMotion
from flexfmu.model.reference_design.loads import OF_CYCLE, ROOTS, Convex, Drives, Loads, power, weight_of_squares
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

Distances = Callable[[RealArray], tuple[RealArray, RealArray]]
"""Points of ways (P, N, 2) [m] → distances (K, P, N) [m], negative where the end effector must not be, and their gradients (K, P, N, 2)."""

GROUPS = (
    "torque", "speed", "acceleration", "jerk", "clearance", "residual", "rms_torque", "power", "energy", "supply_power",
    "regenerated_power", "regenerated_energy", "motor_torque", "motor_rms_torque", *LINK_LOADS,
)  # fmt: skip
RATES, RESIDUAL = GROUPS[1:4], 5

DEPTH = 1e-3
"""Depth [m] that counts as much as a torque twice as large as allowed."""

RESIDUAL_SCALE = 0.02
"""A residual vibration twice as large as allowed counts as much as a torque 2 % too large: it ends small anyway."""

DIRECTIONS = np.arange(8) * np.pi / 4
"""Normals [rad] of the half planes that bound the amplitude of a mode; with 8 of them to 8 %."""

WORST = 3
"""Number of variants whose torques and distances count at an instant: those of variants with similar payloads are similar."""

TINY = 1e-9
"""An RMS torque that is none [N m, or 1 of motors]."""

SLOW = 6.0
"""Modes up to this multiple of a variant's lowest frequency count; smooth references don't excite faster ones."""


def _deciding(name: str, values: RealArray) -> NDArray[np.bool_]:
    """Which of a part's rows can decide: those that a step can bring near, at each instant of the `WORST` variants."""
    axis, near = 1 if name == "clearance" else 0, values > -2.0 * NEAR[GROUPS.index(name)]
    if name in (*RATES, *OF_CYCLE) or values.shape[axis] <= WORST:
        return np.asarray(near)
    least = np.partition(values, -WORST, axis=axis).take([-WORST], axis=axis)
    return np.asarray(near & (values >= least))


class ResidualVibration:
    """Modal amplitudes of the vibration that remains at the end, in displacements of the end effector.

    Args:
        models: the variants of each scene.
        end: joint angles after the motion (2,) [rad].
        settled_within: time after the motion from which the vibration counts [s].
    """

    def __init__(self, models: Sequence[VariantModel], end: RealArray, settled_within: float = 0.0) -> None:
        self.rests = [model.rest(end) for model in models]
        # from elastic coordinates and their rates at the end: (P, 2, k, n)
        self.matrices = joined([_to_amplitudes(rest, settled_within) for rest in self.rests])
        self.holding = joined([rest.torque for rest in self.rests])
        self._rest = joined([rest.elastic for rest in self.rests])
        self.error = np.zeros((len(self._rest), 2, self._rest.shape[1]))

    def away(self, end: RealArray) -> RealArray:
        """States at the end (P, 2, n) relative to rest, the grid's error added."""
        away = end + self.error
        away[:, 0] -= self._rest
        return away


def bounds(matrices: RealArray, states: RealArray) -> RealArray:
    """Bounds (P,) [m] of the displacement by states (P, 2, n) after the motion, with matrices of `ResidualVibration`."""
    amplitudes = (matrices @ states[..., np.newaxis])[..., 0]
    return np.asarray(np.linalg.norm(amplitudes, axis=1).sum(axis=-1))


class LeftVibration:
    """What the ways of a cycle leave of vibration in the next, in the periodic motion; until `renew` nothing: each starts from rest.

    The payload changes at the end of the pause, carried by what it lies on: elastic coordinates keep their distance from rest; their rates stay
    where a payload is left, and where one at rest is gripped the momentum of each coordinate stays.

    Args:
        starts, ends: the robots of each way at rest before and after it, by scene.
        pauses: time at rest after each way [s].
        of_case: index of the robot of each case for each way (W, C).
    """

    def __init__(
        self,
        starts: Sequence[Sequence[Rest]],
        ends: Sequence[Sequence[Rest]],
        pauses: Sequence[float],
        of_case: Sequence[NDArray[np.intp]],
    ) -> None:
        self.of_case, self._handed = of_case, list[RealArray]()
        before, after = (
            [joined([rest.mass for rest in each])[cases] for each, cases in zip(rests, of_case, strict=True)]
            for rests in (starts, ends)
        )
        for w, (rests, pause, cases) in enumerate(zip(ends, pauses, of_case, strict=True)):
            systems = [rest.system for rest in rests]
            decays = joined(
                [expm(each * pause).reshape(len(each), 2, n, 2, n) for each in systems for n in [each.shape[1] // 2]]
            )
            handed, now, then = decays[cases], after[w], before[(w + 1) % len(before)]
            heavier = np.trace(then - now, axis1=1, axis2=2) > 0.0
            # coordinates that a scene doesn't have
            none = np.eye(now.shape[1]) * (np.diagonal(then, axis1=1, axis2=2) == 0.0)[:, np.newaxis]
            gripped = np.linalg.solve((then + none)[heavier], now[heavier])
            handed[heavier, 1] = np.einsum("cij,cj...->ci...", gripped, handed[heavier, 1])
            self._handed.append(handed)
        self.renew([np.zeros_like(each) for each in self._handed])

    def renew(self, transfers: Sequence[RealArray]) -> None:
        """Take new transfers (P, 2, n, 2, n) from start to end of each way, see `ElasticResponse.transfer`; ``growth`` (C,) is by how much
        vibration is larger after a cycle, at most: a periodic motion needs less than 1."""
        count, cases, _, n, *_ = (len(transfers), *self._handed[0].shape)
        size = 2 * n
        moved = np.zeros((cases, count * size, count * size))
        for w, handed in enumerate(self._handed):
            k = (w + 1) % count
            both = transfers[k][self.of_case[k]].reshape(cases, size, size) @ handed.reshape(cases, size, size)
            moved[:, k * size : (k + 1) * size, w * size : (w + 1) * size] += both
        self._matrix = np.linalg.inv(np.eye(count * size) - moved)
        round_trip = np.linalg.matrix_power(moved, count)[:, :size, :size]
        self.growth = np.abs(np.linalg.eigvals(round_trip)).max(axis=1, initial=0.0)

    def periodic(self, states: Sequence[RealArray]) -> list[RealArray]:
        """States at the ends of the ways (C, 2, n, ...) in the periodic motion, by those from rest (P, 2, n, ...)."""
        own = np.stack([each[cases] for cases, each in zip(self.of_case, states, strict=True)], axis=1)
        found = self._matrix @ own.reshape(*self._matrix.shape[:2], math.prod(own.shape[4:]))
        return list(found.reshape(own.shape).swapaxes(0, 1))


def _to_amplitudes(rest: Rest, settled_within: float) -> RealArray:
    """Matrices (P, 2, k, n) from elastic coordinates and their rates to displacements of the end effector by the k slowest modes, which
    have decayed for a time [s]."""
    frequencies, shapes = rest.modes
    count = int((frequencies < SLOW * frequencies[:, :1]).any(axis=0).sum())
    size = np.linalg.norm(rest.displacement @ shapes, axis=1)[:, :count, np.newaxis]
    if settled_within:
        damping = np.einsum("pik,pij,pjk->pk", shapes, rest.damping, shapes)
        size = size * np.exp(-0.5 * settled_within * damping)[:, :count, np.newaxis]
    # from elastic coordinates to modal ones
    coordinates = np.linalg.inv(shapes)[:, :count] * size
    return np.stack([coordinates, coordinates / frequencies[:, :count, np.newaxis]], axis=1)


PRICES = 2.0, 500.0
"""Price of a slack, in costs of the start, at first and at most; it grows while limits that can be met aren't."""

REACH = 0.1
"""Largest change of a coefficient in one step, relative to the swing of the joints, and of the duration."""

NEAR = np.where(np.array(GROUPS) == "clearance", 3.0, 0.15)
"""Torques and references that stay so far below their limit, relative to it, don't enter a programme, nor distances above 3 mm: one for
each of `GROUPS`. Those within twice as much are linearised, since a step may bring them near."""

MET = 1e-4
"""Violation up to which a limit counts as met."""

CURVED = 1e-4
"""Least curvature of the merit, in durations for a change of all coefficients by the swing: programmes have one solution."""

PENALTY = 0.3, 1e4
"""Penalty on changes of the accelerations at first, and at most."""

CORRECTIONS = 2
"""Largest number of corrections of a step."""

ENOUGH = 1e-3
"""Predicted fall of the merit, relative to the start's cost, below which a motion is the best."""


Aim = Literal["time", "torque", "rms_torque", "energy", "residual", "limits"]
"""What is minimised; all but time at a given duration. The aim "residual" is the least RMS torques within its bound, "limits" a motion
near the first that meets them."""

PEAK = 8
"""Power whose mean stands for a peak."""

ROUNDING = 0.05
"""Power within which the corner at zero is rounded, relative to the largest one of the start."""


def _rounded(y: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """The positive part, with a rounded corner."""
    root = np.sqrt(y**2 + ROUNDING**2)
    return 0.5 * (y + root), 0.5 * (1.0 + y / root), 0.5 * ROUNDING**2 / root**3


EFFORTS: Mapping[Aim, tuple[str, Convex]] = {
    "torque": ("torque", power(PEAK)), "rms_torque": ("torque", power(2)), "energy": ("power", _rounded), "residual": ("torque", power(2)),
}  # fmt: skip
"""What is minimised → the load and its function whose integral it is, a mean over variants and joints."""


def _effort(aim: Aim, first: Loads) -> tuple[str, Convex]:
    """The load and its function whose integral, over all variants and joints, is 1 at the first motion."""
    load, convex = EFFORTS[aim]
    largest, unit = np.abs(first.values(load)).max(), 1.0

    def cost(y: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        value, slope, curvature = convex(y / largest)
        return value / unit, slope / largest / unit, curvature / largest**2 / unit

    unit = float(first.integral(load, cost).sum())
    return load, cost


Motions = tuple[DesignedMotion, ...]
"""One for each way."""


@dataclass(frozen=True, eq=False)
class Way:
    """A motion, alone or of a cycle.

    Attributes:
        robots: the robot of each case, a payload that is carried through the cycle; several cases may have the same, and those of one
            scene follow each other, by payload.
        start: first motion; it may violate limits, and half the duration of a usual motion serves well.
        distances: to what the end effector must keep clear of.
        pause: time at rest after the motion [s], which RMS torques contain.
    """

    robots: Sequence[RobotVariant]
    start: DesignedMotion
    distances: Distances
    pause: float = 0.0


def fleet_of(robots: Sequence[RobotVariant]) -> tuple[list[RobotVariant], NDArray[np.intp]]:
    """Each robot once, and the index of that of each case (C,)."""
    fleet = [*dict.fromkeys(robots)]
    return fleet, np.array([fleet.index(each) for each in robots])


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """Limits of a motion, or of a cycle, for C cases, and first motions from which those that keep them are found.

    Attributes:
        ways: the motion, or the ways of a cycle, each of which starts where the one before ends.
        limits: largest magnitudes by name: of `RATES` for both joint references (2,) [rad/s, rad/s², rad/s³]; of `Loads` for each case,
            of both joints (C, 2) or (C,): at each instant, or of all ways with the pauses after them.
        residual: largest displacement of the end effector by vibration after a motion [m].
        clearance: the smallest distance [m].
        settled_within: time after a motion from which the residual vibration counts [s].
        drives: the motors, for their loads; None for none.
        loose: first bound of the residual vibration [m]; without one larger than the last the first motions are taken to be near the
            best ones.
    """

    ways: Sequence[Way]
    limits: Mapping[str, RealArray]
    residual: float
    clearance: float = 0.0
    settled_within: float = 0.0
    drives: Drives | None = None
    loose: float = 0.0

    def begun(self, motions: Iterable[DesignedMotion], share: float = 1.0, loose: float = 0.0) -> MotionProblem:
        """The problem with other first motions, each in a share of its duration."""
        starts = [each.with_duration(share * each.duration) for each in motions]
        ways = [replace(way, start=start) for way, start in zip(self.ways, starts, strict=True)]
        return replace(self, ways=ways, loose=loose)

    def tightened(self, factors: Mapping[str, float]) -> MotionProblem:
        """The problem with limits divided by factors, 1 where there is none; the clearance is larger by ``clearance`` [m]."""
        return replace(
            self,
            limits={name: limit / factors.get(name, 1.0) for name, limit in self.limits.items()},
            residual=self.residual / factors.get("residual", 1.0),
            clearance=self.clearance + factors.get("clearance", 0.0),
        )

    def of_cases(self, chosen: NDArray[np.intp]) -> MotionProblem:
        """The problem of some cases."""
        ways = [replace(way, robots=[way.robots[k] for k in chosen]) for way in self.ways]
        limits = {name: limit if name in RATES else limit[chosen] for name, limit in self.limits.items()}
        return replace(self, ways=ways, limits=limits)


@dataclass(frozen=True, eq=False)
class WayState:
    """The motion of one way.

    Attributes:
        way: what a stage knows of the way.
        motion: the joint references.
        loads: its loads, with the response to it.
        parts: each part of the limits at instants: the name of its group, and g.
        gradient: of the distances (K, P, N, 2).
    """

    way: _WayProgramme
    motion: DesignedMotion
    loads: Loads
    parts: Sequence[tuple[str, RealArray]]
    gradient: RealArray


@dataclass(frozen=True, eq=False)
class State:
    """Motions, and what they cost in units of the start's.

    Attributes:
        ways: the motions.
        loads: of the cycle by name, relative to their limits (C, r), and derivatives by what the ways add and by its duration.
        amplitudes: modal places and rates at the end of each way, all modes behind each other (C, 2, k) [m].
        bounds: of the displacement by vibration after each way (C, W) [m].
        allowed: largest bound [m].
        cost: what is minimised.
    """

    ways: tuple[WayState, ...]
    loads: Mapping[str, tuple[RealArray, RealArray, RealArray]]
    amplitudes: RealArray
    bounds: RealArray
    allowed: float
    cost: float

    @property
    def motions(self) -> Motions:
        """The motions of all ways."""
        return tuple(way.motion for way in self.ways)

    @property
    def parts(self) -> list[tuple[str, RealArray]]:
        """Each part of the limits, of each way at its instants and of the cycle: the name of its group, and g."""
        of_cycle = ((name, share - 1.0) for name, (share, *_) in self.loads.items())
        return [*(part for way in self.ways for part in way.parts), *of_cycle]

    @cached_property
    def values(self) -> RealArray:
        """g of all parts (N,)."""
        return np.concatenate([each.ravel() for _, each in self.parts])

    @cached_property
    def violations(self) -> dict[str, float]:
        """The largest of each of `GROUPS`, zero or positive."""
        found = dict.fromkeys(GROUPS, 0.0)
        for name, each in [*self.parts, ("residual", (self.bounds / self.allowed - 1.0) * RESIDUAL_SCALE)]:
            found[name] = max(found[name], float(each.max(initial=0.0)))
        return found

    def of_parts(self, rows: RealArray) -> list[RealArray]:
        """What all rows have (N,), by part."""
        ends = np.cumsum([each.size for _, each in self.parts])
        return [each.reshape(part.shape) for each, (_, part) in zip(np.split(rows, ends), self.parts, strict=False)]


@dataclass(frozen=True, eq=False)
class Linear:
    """The limits, linearised at motions, by the m variables of all ways.

    Attributes:
        deciding: which of all rows (N,) can decide.
        values, groups, jacobian: their g (R,), indices of their groups (R,) and derivatives (R, m).
        amplitudes, amplitudes_by: modal amplitudes (C, 2, k), with derivatives (C, 2, k, m).
        slope, curvature: of the cost, (m,) and (m, m).
        room: largest steps of the variables, down and up (2, m).
    """

    deciding: NDArray[np.bool_]
    values: RealArray
    groups: NDArray[np.intp]
    jacobian: RealArray
    amplitudes: RealArray
    amplitudes_by: RealArray
    slope: RealArray
    curvature: RealArray
    room: RealArray


class _WayProgramme:
    """What a stage knows of one way: the response, the limits at each instant, the vibration after it, the columns of its variables.

    Args:
        problem: the limits.
        way: the way.
        start: its first motion.
        parts: steps of the integration for each interval of the spline.
        first: its first column.
        aim: what is minimised.
    """

    def __init__(
        self, problem: MotionProblem, way: Way, start: DesignedMotion, parts: int, first: int, aim: Aim
    ) -> None:
        self._problem, self._way, (self.robots, self.cases) = problem, way, fleet_of(way.robots)
        before, after = start.evaluate([0.0, 1.0], 0)[0]
        self._links = tuple(name for name in LINK_LOADS if name in problem.limits)
        self.elastic = ElasticResponse(self.robots, before, parts * start.intervals, self._links, COMPARED, SHARED)
        self.vibration = ResidualVibration(self.elastic.models, after, problem.settled_within)
        # of each load at all instants, the least of a robot's cases; link loads have one limit each for all their places
        self.units = {
            name: np.array([[limit[self.cases == k].min(axis=0).ravel()] for k in range(len(self.robots))])
            for name, limit in problem.limits.items()
            if name not in (*RATES, *OF_CYCLE)
        }
        self.scale, self.metric = start.measures(way.start.duration)
        self.columns = slice(first, first + len(self.scale))
        self.effort = _effort(aim, self.state(start, derivatives=False).loads) if aim in EFFORTS else None

    def state(self, motion: DesignedMotion, *, derivatives: bool) -> WayState:
        """Evaluate a motion."""
        response, problem = self.elastic.of_motion(motion, derivatives=derivatives), self._problem
        loads = Loads(response, self.vibration.holding, self._way.pause, problem.drives, self._links)
        rates = motion.rates(self.elastic.fractions, response.references, response.references_by)
        distance, gradient = self._way.distances(response.position)
        parts = [
            *((name, np.abs(each) / problem.limits[name] - 1.0) for name, (each, _) in zip(RATES, rates, strict=True)),
            ("speed", motion.conditions()[0]),
            *((name, np.abs(loads.values(name)) / unit - 1.0) for name, unit in self.units.items()),
            ("clearance", (problem.clearance - distance) / DEPTH),
        ]
        return WayState(self, motion, loads, parts, gradient)

    def rows(self, state: WayState) -> list[RealArray]:
        """Derivatives (R, m) of the limits that can decide at each instant, by part."""
        motion, loads, deciding = state.motion, state.loads, [_deciding(*part) for part in state.parts]
        rates = motion.rates(self.elastic.fractions, loads.response.references, loads.response.references_by)
        found = [
            np.sign(each)[..., np.newaxis] * by / self._problem.limits[name][:, np.newaxis]
            for name, (each, by) in zip(RATES, rates, strict=True)
        ]
        found = [each[some] for each, some in zip([*found, motion.conditions()[1]], deciding, strict=False)]
        for (name, unit), some in zip(self.units.items(), deciding[4:], strict=False):
            found.append((np.sign(loads.values(name)) / unit)[some][:, np.newaxis] * loads.rows(name, some))
        some = deciding[-1]
        _, variant, instant = np.nonzero(some)
        position_by = loads.response.position_by[variant, instant]
        return [*found, -np.einsum("rj,rjm->rm", state.gradient[some], position_by) / DEPTH]

    def curvature(self, state: WayState, prices: Sequence[RealArray], of_cycle: Mapping[str, RealArray]) -> RealArray:
        """The positive part of the curvature (m, m) of the cost, and of the loads at their prices.

        Args:
            state: the motion.
            prices: of each part.
            of_cycle: of each unit that the robots add to loads of the cycle, (P, r).
        """
        loads, found = state.loads, np.zeros_like(self.metric)
        if self.effort is not None:
            found += loads.integral_curvature(*self.effort, np.ones((len(loads.response.torque), 1)))
        for (name, _), price in zip(state.parts, prices, strict=True):
            if name in self.units:
                found += loads.curvature(name, np.sign(loads.values(name)) * price / self.units[name])
        for name, price in of_cycle.items():
            found += loads.integral_curvature(*OF_CYCLE[name], price)
        values, vectors = np.linalg.eigh(found)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


class Stage:
    """The programmes of a problem from some motions on.

    Args:
        problem: limits and cases; the durations of its first motions cost 1 in all.
        start: the motions; their effort costs 1.
        parts: steps of the integration for each interval of the splines.
        aim: what is minimised.
    """

    def __init__(self, problem: MotionProblem, start: Motions, parts: int, aim: Aim = "time") -> None:
        self.problem, self._start, self.ways = problem, start, list[_WayProgramme]()
        for way, motion in zip(problem.ways, start, strict=True):
            first = self.ways[-1].columns.stop if self.ways else 0
            self.ways.append(_WayProgramme(problem, way, motion, parts, first, aim))
        self._limits = {
            name: limit.reshape(len(limit), -1) for name, limit in problem.limits.items() if name in OF_CYCLE
        }
        self.unit = sum(way.start.duration for way in problem.ways)
        self.price, self.penalty = PRICES[0], PENALTY[0]
        # of all rows: none at first
        self._prices = np.zeros(1)
        self._scale = np.concatenate([way.scale for way in self.ways])
        if aim != "time":
            # the durations are given
            self._scale[[way.columns.stop - 1 for way in self.ways]] = 0.0
        self._metric = block_diag(*(way.metric for way in self.ways))
        # which modes are whose (W, k)
        self._modes = block_diag(*(np.ones(way.vibration.matrices.shape[2]) for way in self.ways))
        starts, ends = [way.elastic.starts for way in self.ways], [way.vibration.rests for way in self.ways]
        self._left = LeftVibration(starts, ends, [way.pause for way in problem.ways], [way.cases for way in self.ways])

    def state(self, motions: Motions, *, derivatives: bool = True, renewed: bool = False) -> State:
        """Evaluate motions; with derivatives, or if it is wanted, with new transfers of vibration from way to way."""
        pairs = list(zip(self.ways, motions, strict=True))
        ways = tuple(way.state(motion, derivatives=derivatives) for way, motion in pairs)
        if len(ways) > 1 and (derivatives or renewed):
            self._left.renew([way.elastic.transfer(motion.duration) for way, motion in pairs])
        loads = {name: self._load(name, ways) for name in self._limits}
        cost = sum(each.motion.duration for each in ways) / self.unit
        if efforts := [each.loads.integral(*each.way.effort) for each in ways if each.way.effort]:
            cost = float(np.mean([each.sum() for each in efforts]))
        amplitudes = self._amplitudes([each[..., np.newaxis] for each in self._ends(ways)])[..., 0]
        return State(
            ways, loads, amplitudes, np.linalg.norm(amplitudes, axis=1) @ self._modes.T, self.problem.residual, cost
        )

    def _ends(self, ways: Sequence[WayState]) -> list[RealArray]:
        """States at the end of each way relative to rest (C, 2, n)."""
        return self._left.periodic([each.way.vibration.away(each.loads.response.end) for each in ways])

    def _amplitudes(self, ends: Sequence[RealArray]) -> RealArray:
        """Modal places and rates (C, 2, k, ...) [m] of all ways, by states at their ends (C, 2, n, ...)."""
        pairs = zip(self.ways, ends, strict=True)
        return np.concatenate([way.vibration.matrices[way.cases] @ each for way, each in pairs], axis=2)

    def _load(self, name: str, ways: Sequence[WayState]) -> tuple[RealArray, RealArray, RealArray]:
        """A load of the cycle relative to its limit (C, r), with derivatives by what the ways add and by the cycle's duration."""
        whole, limit = np.sum([each.loads.of_cycle(name)[each.way.cases] for each in ways], axis=0), self._limits[name]
        if name not in ROOTS:
            return whole / limit, 1.0 / limit, np.zeros_like(whole)
        # a root of a mean square
        time = sum(each.motion.duration for each in ways) + sum(way.pause for way in self.problem.ways)
        weight, slope = weight_of_squares(name, time, self.problem.drives)
        root = np.sqrt(whole * weight)
        by = 0.5 / (np.maximum(root, TINY) * limit)
        return root / limit, weight * by, whole * slope * by

    def merit(self, state: State) -> float:
        """The cost, and the price of what isn't met."""
        return state.cost + self.price * sum(state.violations.values())

    def linear(self, state: State) -> Linear:
        """Linearise the limits at motions."""
        m, jacobian = len(self._scale), block_diag(*(np.concatenate(each.way.rows(each)) for each in state.ways))
        # loads of the cycle, whose time has all durations
        for name, (share, by_whole, by_time) in state.loads.items():
            by = np.zeros((*share.shape, m))
            for each in state.ways:
                columns = each.way.columns
                by[..., columns] += by_whole[..., np.newaxis] * each.loads.integral_by(*OF_CYCLE[name])[each.way.cases]
                by[..., columns.stop - 1] += by_time
            jacobian = np.concatenate([jacobian, by[_deciding(name, share - 1.0)]])
        deciding = np.concatenate([_deciding(*part).ravel() for part in state.parts])
        groups = np.repeat([GROUPS.index(name) for name, _ in state.parts], [each.size for _, each in state.parts])
        # vibration
        ends_by = [np.zeros((*each.loads.response.end.shape, m)) for each in state.ways]
        for each, by in zip(state.ways, ends_by, strict=True):
            by[..., each.way.columns] = each.loads.response.end_by
        amplitudes_by = self._amplitudes(self._left.periodic(ends_by))
        # the cost
        slope, curvatures = np.zeros(m), list[RealArray]()
        prices = state.of_parts(np.broadcast_to(self._prices, state.values.shape))
        of_cycle = prices[len(prices) - len(state.loads) :]
        for each in state.ways:
            way = each.way
            if way.effort is None:
                slope[way.columns.stop - 1] = 1.0 / self.unit
            else:
                slope[way.columns] = each.loads.integral_by(*way.effort).sum(axis=(0, 1)) / len(self.ways)
            # of each unit that its robots add to loads of the cycle
            units = dict[str, RealArray]()
            for (name, (_, by, _)), price in zip(state.loads.items(), of_cycle, strict=True):
                units[name] = np.zeros((len(way.vibration.holding), price.shape[1]))
                np.add.at(units[name], way.cases, price * by)
            own, prices = prices[: len(each.parts)], prices[len(each.parts) :]
            curvatures.append(way.curvature(each, own, units))
        return Linear(
            deciding,
            state.values[deciding],
            groups[deciding],
            jacobian,
            state.amplitudes,
            amplitudes_by,
            slope,
            block_diag(*curvatures),
            np.concatenate([motion.room for motion in state.motions], axis=1),
        )

    def corrected(self, linear: Linear, step: RealArray, state: State) -> Linear:
        """The linearised limits with their values after a step."""
        values = state.values[linear.deciding] - linear.jacobian @ step
        return replace(linear, values=values, amplitudes=state.amplitudes - linear.amplitudes_by @ step)

    def step(self, linear: Linear, penalty: float) -> tuple[RealArray, float, float]:
        """The best step (m,), the change of the cost with the price of what isn't met after it, and the sum of that, as they predict.

        The multipliers of the rows are kept: they weigh the curvature of the next programme.
        """
        m, slacks, (cases, _, modes) = len(self._scale), np.eye(len(GROUPS)), linear.amplitudes.shape
        near, scale = np.flatnonzero(linear.values > -NEAR[linear.groups]), RESIDUAL_SCALE / self.problem.residual
        # half planes of each mode's amplitude, and the sums of amplitudes of each way
        normals, bounded = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)]), np.eye(cases * modes)
        planes = scale * np.einsum("id,pikm->dpkm", normals, linear.amplitudes_by).reshape(-1, m)
        sums = np.kron(np.eye(cases), self._modes)
        none = np.zeros((len(planes), len(slacks)))
        matrix = np.block(
            [
                [linear.jacobian[near], -slacks[linear.groups[near]], np.zeros((len(near), len(bounded)))],
                [planes, none, np.tile(-np.cos(DIRECTIONS[1] / 2) * bounded, (len(DIRECTIONS), 1))],
                [np.zeros((len(sums), m)), -slacks[[RESIDUAL] * len(sums)], sums],
            ]
        )
        away = scale * np.einsum("id,pik->dpk", normals, linear.amplitudes).ravel()
        right = np.concatenate([-linear.values[near], -away, np.full(len(sums), RESIDUAL_SCALE)])
        # in units of the scale
        size = matrix.shape[1]
        unit = np.concatenate([self._scale, np.ones(size - m)])
        quadratic, cost = np.zeros((size, size)), np.zeros(size)
        quadratic[:m, :m] = penalty * self._metric + linear.curvature
        quadratic *= unit[:, np.newaxis] * unit
        quadratic[range(m), range(m)] += CURVED
        cost[:m], cost[m : m + len(slacks)] = linear.slope, self.price
        lower, upper = np.zeros(size), np.full(size, np.inf)
        lower[:m], upper[:m] = np.clip(linear.room / self._scale, -REACH, REACH)
        x, prices = solve_quadratic(quadratic, cost * unit, matrix * unit, right, lower, upper)
        x = unit * x
        self._prices = np.zeros(len(linear.deciding))
        self._prices[np.flatnonzero(linear.deciding)[near]] = prices[: len(near)]
        predicted = float(cost @ x) + 0.5 * float(x[:m] @ linear.curvature @ x[:m])
        return x[:m], predicted, float(x[m : m + len(slacks)].sum())

    def improvements(self, iterations: int, penalty: float = PENALTY[0]) -> Iterator[State]:
        """Better and better motions, from the start on.

        Args:
            iterations: largest number of programmes.
            penalty: first penalty on changes of the accelerations.
        """
        state = self.state(self._start)
        linear = self.linear(state)
        yield state
        for _ in range(iterations):
            step, predicted, missed = self.step(linear, penalty)
            if missed > sum(state.violations.values()) + MET and self.price < PRICES[1]:
                # it would rather miss more than it does
                self.price *= 4.0
                continue
            fall = self.merit(state) - state.cost - predicted
            worst = max(state.violations.values())
            if fall < max(ENOUGH, 0.02 * self.price * worst):
                # the best motion, or one that would rather pay than meet its limits
                if worst < MET or self.price >= PRICES[1]:
                    return
                self.price *= 4.0
                continue
            found = self._after_step(state, linear, step, penalty, fall)
            ratio = (self.merit(state) - self.merit(found)) / fall
            if ratio > 0.1:
                motions = found.motions
                # derivatives are large
                del state, linear, found
                state = self.state(motions)
                linear = self.linear(state)
                yield state
            penalty *= 4.0 if ratio < 0.1 else 2.0 if ratio < 0.4 else 0.4 if ratio > 0.8 else 1.0
            self.penalty = penalty
            if penalty > PENALTY[1]:
                return

    def _after_step(self, state: State, linear: Linear, step: RealArray, penalty: float, fall: float) -> State:
        """The motions after a step, or after its second-order correction if that is better; the old ones where there are none."""
        try:
            found = self.state(self._moved(state.motions, step), derivatives=False)
            last = found
            for _ in range(CORRECTIONS):
                if (self.merit(state) - self.merit(found)) / fall > 0.9:
                    break
                step = self.step(self.corrected(linear, step, last), penalty)[0]
                last = self.state(self._moved(state.motions, step), derivatives=False)
                found = min(found, last, key=self.merit)
        except (EquilibriumError, TrajectoryError):
            return state
        return found

    def _moved(self, motions: Motions, step: RealArray) -> Motions:
        """The motions after a step of the variables."""
        return tuple(motion.moved(step[way.columns]) for way, motion in zip(self.ways, motions, strict=True))


LOOSE = 2e-5
"""Bound of the residual vibration [m] in the first stage."""

NODES = 9
"""Number of variants that the programmes have: 7 payloads within 30 % leave 1 µm of residual vibration between them."""

CHECKED = {**dict.fromkeys(GROUPS, 3e-4), **dict.fromkeys(RATES, 1e-4), "clearance": 1.5e-2, "residual": 6e-4}
"""Violations of `GROUPS` up to which the limits count as met on the fine grid: 15 µm, and 3 % of the residual."""

ROUNDS = 8
"""Largest number of evaluations of all variants on the fine grid."""

JOINING, TIGHTER = 0.8, 1.04
"""Share of the allowed residual vibration from which on a variant between others joins them, and by how much its bound falls in a round, at
most: those that join lower it too."""

PHASE, FINER = 2.5, 2
"""Phase [rad] of the faster of the two lowest modes of the lightest robot in a step of the coarse grid, at most, and how much finer the other grid is."""


Improvement = tuple[Motions, Mapping[str, float]]
"""Motions on the way to the best ones, and the largest relative violation of each of `GROUPS` among the variants that were considered; 0 where it is
met."""


def optimal_motion(
    problem: MotionProblem, nodes: Sequence[int] | None = None, *, iterations: int = 40, aim: Aim = "time"
) -> Iterator[Improvement]:
    """Joint references that are better and better within limits that hold for all robots.

    Args:
        problem: the limits, and the first motions.
        nodes: indices of the cases that the programmes have; None for `NODES` that are denser near both ends.
        iterations: largest number of programmes in each stage.
        aim: what is minimised; all but time in the durations of the first motions.

    Yields:
        Motions on the way; the last ones are the best if all variants meet the limits on the fine grid, within `CHECKED`.

    Raises:
        EquilibriumError: the first motions have no elastic motion.
    """
    ways, limit, loose = problem.ways, problem.residual, max(problem.residual, problem.loose)
    count, motions, parts = len(ways[0].robots), tuple(way.start for way in ways), max(map(_parts, ways))
    chosen = np.array(spread(count, NODES) if nodes is None else nodes)
    penalty = PENALTY[0]
    if loose > limit:
        # few variants first; otherwise the first motion is near the best one
        few = problem.tightened({"residual": limit / loose}).of_cases(chosen[spread(len(chosen), 3)])
        stage = Stage(few, motions, parts, aim)
        for motions, violations in map(_improvement, stage.improvements(iterations)):
            yield motions, violations
        penalty = max(PENALTY[0], min(4.0 * stage.penalty, 10.0))
    # all variants on the fine grid
    fine = Stage(problem, motions, FINER * parts, aim)
    exact = fine.state(motions, derivatives=False, renewed=True)
    for _ in range(ROUNDS):
        # the worst variants join the nodes
        residuals = exact.bounds.max(axis=1)
        around = np.pad(residuals, 1)
        is_worst = (residuals >= np.maximum(around[:-2], around[2:])) & (residuals > JOINING * limit)
        chosen = np.unique([*chosen, *np.flatnonzero(is_worst)])
        stage = Stage(problem.of_cases(chosen), motions, parts, aim)
        coarse = stage.state(motions, derivatives=False, renewed=True)
        for there, here in zip(exact.ways, coarse.ways, strict=True):
            robots = [there.way.robots.index(each) for each in here.way.robots]
            here.way.vibration.error = there.loads.response.end[robots] - here.loads.response.end
        before = motions
        for motions, violations in map(_improvement, stage.improvements(iterations, penalty)):
            yield motions, violations
        exact = fine.state(motions, derivatives=False, renewed=True)
        missed = {name: each for name, each in exact.violations.items() if each > CHECKED[name]}
        yield _improvement(exact)
        # programmes that don't meet their limits by any step won't meet tighter ones
        if not missed or (motions == before and max(violations.values()) > MET):
            return
        # what else lies between them, or between instants, tightens the limits
        factors = {name: (1.0 + violation) / 0.9998 for name, violation in missed.items()}
        residual = min(float(exact.bounds.max()) / limit, TIGHTER)
        own = {"residual": residual, "clearance": DEPTH * missed.get("clearance", 0.0)}
        problem = problem.tightened(factors | {name: each for name, each in own.items() if name in missed})
        # with the worst case of each load
        sizes = [(name, share) for name, (share, *_) in exact.loads.items()]
        for way in exact.ways:
            sizes += [(name, each[way.way.cases]) for name, each in way.parts if name in way.way.units]
        worst = [int(np.unravel_index(each.argmax(), each.shape)[0]) for name, each in sizes if name in missed]
        chosen = np.unique([*chosen, *worst])


def _parts(way: Way) -> int:
    """Steps of the integration for each interval of a way's splines, at least two."""
    robot, motion = way.robots[0], way.start
    rest = VariantModel([robot]).rest(motion.evaluate(0.0, 0)[0, 0])
    highest = float(rest.modes[0][:, :2].max(initial=0.0))
    return max(2, math.ceil(highest * motion.duration / motion.intervals / PHASE))


def spread(count: int, number: int) -> list[int]:
    """Indices of a number of things in a row of a count, denser near both ends (Chebyshev's nodes)."""
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(number) + 0.5) / number) / np.cos(0.5 * np.pi / number)
    return sorted({int(k) for k in np.rint(nodes * (count - 1))}) if number > 1 else [(count - 1) // 2]


def _improvement(state: State) -> Improvement:
    return state.motions, state.violations
