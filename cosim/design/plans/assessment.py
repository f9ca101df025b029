"""What a planned motion is worth: the FMU's runs over the bands, against the limits and the given motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.goals import RATES, Goals, Variation, peak_rates
from flexfmu.cosim.design.plans.sampled_loop import completed, left_in_loop, with_learned_torques
from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.experiment.metric import RunMetrics
from flexfmu.cosim.experiment.planning import plan, plan_own
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of, own_loop
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import PLAN_FIGURES, definition, metric
from flexfmu.cosim.metrics.metrics import RecordedPower, RecordedSignal, RecordedSolution, settings_for
from flexfmu.cosim.metrics.motors import motor_loads
from flexfmu.cosim.metrics.signals import TORQUES, deviation_from_point, position, sample, segments
from flexfmu.cosim.metrics.stress import link_stresses
from flexfmu.model.reference_design.elastic_response import ElasticResponse, Rest
from flexfmu.model.reference_design.loads import OF_CYCLE, ROOTS, weight_of_squares
from flexfmu.model.reference_design.optimal_control import LeftVibration, ResidualVibration, bounds
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.sources import OwnMotion, as_trajectory
from flexfmu.trajectories.trajectory import Trajectory

Method = Literal["given", "search", "flexible references", "optimal control", "csv"]
"""Where a candidate comes from."""

STEP, TOLERANCE = 4e-4, 1e-8
"""Communication step [s] and tolerance of the runs that judge; largest torques, depths and distances are looked for at the middle of steps too."""

WITHIN = 5
"""Instants of a step, both ends included, among which the largest force in a joint is found; stresses have as many."""

SAME_PLACE = 1e-5
"""Distance [m] within which a user's motion starts and ends where the scene's does."""

JUDGED = 25
"""Payloads of the band for which every motion is judged."""

STEPS, CYCLES = 300, 100
"""Steps of the integration that tells what a way leaves in the next, as many as samples of a drive's table if these are more, and cycles after
which vibration that grows is judged."""

SAMPLES = 65
"""Instants at which references are compared with those in a journal."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A motion that a plan could choose.

    Attributes:
        label: what it is, in a few words.
        method: where it comes from.
        scene: the scene with this motion's keys.
        trajectory: motion of the joints q11, q21 [rad], in place of the scene's; None for the scene's own motion.
        cycle: the motions of a cycle; empty for a single motion. The scene is that of the first one.
        is_rough: whether it was planned for few robots, as a start for a motion for all, which is preferred.
    """

    label: str
    method: Method
    scene: Scene
    trajectory: Trajectory | None = None
    cycle: tuple[Candidate, ...] = ()
    is_rough: bool = False

    @classmethod
    def of(cls, goals: Goals, label: str, method: Method, motions: Iterable[Trajectory | None]) -> Candidate:
        """The motion or the cycle of these references, one for each way; None for the scene's own motion."""
        pairs = zip(goals.ways, motions, strict=True)
        ways = tuple(cls(label, method, each.scene, motion) for each, motion in pairs)
        return replace(ways[0], cycle=ways) if goals.cycle else ways[0]

    @property
    def ways(self) -> tuple[Candidate, ...]:
        """The motion of each way; a single motion is its only one."""
        return self.cycle or (self,)

    @property
    def content(self) -> Mapping[str, Any]:
        """What tells the motion from others: keys of the scene, and samples of its own references."""
        if self.cycle:
            return {"ways": [each.content for each in self.ways]}
        references = self.joints.evaluate(np.linspace(0.0, self.joints.duration, SAMPLES), 2, "left")
        return about_scene(self.scene) | {"method": self.method, "references": references}

    @cached_property
    def loop(self) -> Loop:
        """The loop around the robot, with the motion and its shapers.

        Raises:
            TrajectoryError: the motion isn't feasible.
        """
        return loop_of(self.scene) if self.trajectory is None else own_loop(self.scene, self.trajectory)

    @property
    def joints(self) -> Trajectory:
        """Its references of the joints, with shapers; errors as of `loop`."""
        return self.loop.motion.joints

    def prepared(self, step: float = STEP, tolerance: float = TOLERANCE) -> PreparedScene:
        """The candidate, ready for runs; errors as of `loop`."""
        return PreparedScene(self.loop.motion.scene, loop=self.loop, communication_step=step, tolerance=tolerance)


def own_candidate(scene: Scene, name: str, motion: OwnMotion | Trajectory) -> Candidate:
    """A user's motion, to be judged beside those found.

    Raises:
        TrajectoryError: the motion can't be used.
        InputError: it starts or ends elsewhere than the scene's.
    """
    scene = resolved(scene).replace({"shaper": [], "trajectory.references": None})
    given, own = plan(scene).once.task, plan_own(scene, motion).task
    for verb, time, usual in (("starts", 0.0, 0.0), ("ends", own.duration, given.duration)):
        here, wanted = own.evaluate([time], 0, "left")[0, 0], given.evaluate([usual], 0, "left")[0, 0]
        if np.hypot(*(here - wanted)) > SAME_PLACE:
            raise InputError(
                f"the motion {name} {verb} at ({here[0]:.6g}, {here[1]:.6g}) m, that of scene {scene.name} at "
                f"({wanted[0]:.6g}, {wanted[1]:.6g}) m: move it there"
            )
    return Candidate(name, "csv", scene, as_trajectory(motion))


def heading(figure: str) -> str:
    """Heading of a column, with the unit."""
    text = figure.replace("_", " ").replace("rms", "RMS")
    return f"{text[0].upper()}{text[1:]} [{definition(figure).display_unit}]"


WHOLE: Mapping[str, str] = {"time": "whole motion", **dict.fromkeys(RATES, "references")}
"""Figures that robots and joints have in common → where they are."""


def _worst(figure: str) -> Any:
    """The property of an assessment that is the worst value of a figure."""
    info = definition(figure)
    return property(lambda self: self.worst(figure), doc=f"{info.description[:-1]} [{info.unit}].")


Values = Mapping[str, RealArray]
"""Figure → values or instants (R, 1) of all robots, or (R, 2) of both joints too."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a candidate needs, and its use of each limit.

    Figures are ``time`` [s] with shapers, without the dwell; ``torque``, ``rms_torque`` [N.m] and ``power`` [W], largest magnitudes;
    ``residual`` [m], the largest distance from the rest position after the motion; ``energy`` [J] that the motors give, without what they
    take back; ``supply_power`` and ``regenerated_power`` [W] of both motors together, into the robot and out of it, and
    ``regenerated_energy`` [J] that flows out; ``off_path`` [m], the largest distance of the end effector from the given path;
    ``clearance`` [m], the largest depth within the keep-out region, negative outside; ``speed``, ``acceleration`` and ``jerk`` of the joint
    references; with a section `motor` ``motor_torque``, ``motor_rms_torque`` and ``motor_speed`` of the shafts relative to what the motors
    can, the torque at its speed, the RMS torque that heats them as much; and where they are limited ``reaction`` [N], the largest force in
    a joint, and ``stress`` [Pa] of a link.

    Attributes:
        candidate: the motion.
        robots: those within the bands.
        values: what each of them needs, by figure.
        times: instants of some figures [s].
        uses: every limit with what is used of it.
    """

    candidate: Candidate
    robots: tuple[Variation, ...]
    values: Values
    times: Values
    uses: tuple[Limit, ...] = ()

    @property
    def missed(self) -> tuple[Limit, ...]:
        """The limits that it doesn't keep to."""
        return tuple(use for use in self.uses if not use.met)

    @property
    def feasible(self) -> bool:
        """Whether it keeps to all limits."""
        return not self.missed

    @property
    def excess(self) -> float:
        """The largest share of a limit that it misses; 0 if it keeps to all."""
        return max((math.inf if math.isnan(use.share) else use.share for use in self.missed), default=0.0)

    def worst(self, figure: str) -> float:
        """The worst value of a figure within the bands, of both joints."""
        most = float(self.values[figure].max())
        return -most if figure == "clearance" else most

    def shown(self, figure: str) -> str:
        """That value as it is shown."""
        return f"{definition(figure).displayed(self.worst(figure)):.4g}"

    time, residual, torque, rms_torque, power = map(_worst, ("time", "residual", "torque", "rms_torque", "power"))
    supply_power, regenerated_power, energy = map(_worst, ("supply_power", "regenerated_power", "energy"))
    off_path, clearance = map(_worst, ("off_path", "clearance"))
    speed, acceleration, jerk = map(_worst, RATES)

    @cached_property
    def torque_ratio(self) -> float:
        """Worst ratio of peak torques to the given motion's; NaN for the given motion itself."""
        return next((use.value for use in self.uses if use.name == "torque ratio"), math.nan)

    @property
    def row(self) -> dict[str, Any]:
        """Label, method, all of `PLAN_FIGURES`, the torque ratio, and whether it keeps to all limits."""
        names = {"motion": self.candidate.label, "method": self.candidate.method}
        figures = {name: self.worst(name) for name in PLAN_FIGURES}
        return names | figures | {"torque_ratio": self.torque_ratio, "feasible": bool(self.feasible)}

    @property
    def metrics(self) -> RunMetrics:
        """Its figures with units and labels, the worst within the bands."""
        found = {name: metric(name, self.worst(name)) for name in PLAN_FIGURES}
        return RunMetrics(self.candidate.label, lambda companions, names: found)


Judged = tuple[dict[str, list[list[float]]], dict[str, list[list[float]]], tuple[Limit, ...]]
"""What a journal has of an assessment: its values, times and uses."""


FAILURES = (CosimError, TrajectoryError, SceneError, EquilibriumError)
"""Errors of one motion, which don't end the plan."""


@contextmanager
def noted(failures: list[str], what: str = "") -> Iterator[None]:
    """Note why what is done fails; a full disk and the like are no motion's fault, and end the plan."""
    try:
        yield
    except FAILURES as error:
        if isinstance(error.__cause__, OSError):
            raise
        failures.append(f"{what}: {error}" if what else str(error))


class Judge:
    """Assesses candidates of the same goals by runs of the FMU.

    Args:
        goals: limits, bands and clearance.
        payloads: number of payloads within their band; 0 for `JUDGED`.
        journal: where assessments are kept.
        accuracy: communication step [s] and tolerance of the runs; none for `STEP` and `TOLERANCE`.
    """

    def __init__(self, goals: Goals, payloads: int = 0, journal: WorkJournal = NOWHERE, *accuracy: float) -> None:
        self.goals, self.payloads, self.journal, self.accuracy = goals, payloads or JUDGED, journal, accuracy
        # those of the way with most robots
        self.robots = max((each.variations(self.payloads) for each in goals.ways), key=len)

    @cached_property
    def given(self) -> Assessment:
        """The given motion."""
        return self.assess(Candidate.of(self.goals, "given", "given", (each.own for each in self.goals.ways)))

    def assess(self, candidate: Candidate) -> Assessment:
        """Run a candidate over the bands.

        Raises:
            TrajectoryError: the motion isn't feasible.
            ResultsError: a run failed.
            KeyboardInterrupt: after Ctrl-C, which ends a run early.
        """
        place = len(self.robots), "given" if candidate.method == "given" else candidate
        if place not in self.goals.judged:
            key = ["judged", len(self.robots), candidate.content]
            *tables, uses = self.journal.kept(key, Judged, lambda: self._judged(candidate))
            values, times = ({name: np.array(each) for name, each in table.items()} for table in tables)
            self.goals.judged[place] = Assessment(candidate, self.robots, values, times, uses)
        found: Assessment = self.goals.judged[place]
        return found

    def of_ways(self, candidate: Candidate) -> tuple[Assessment, ...]:
        """The assessments of each way of a cycle; arguments and errors as for `assess`."""
        judges = [Judge(each, self.payloads, self.journal) for each in self.goals.cycle]
        return tuple(judge.assess(way) for judge, way in zip(judges, candidate.cycle, strict=True))

    def _of_cycle(self, ways: Sequence[Assessment]) -> tuple[Values, Values]:
        """What a cycle needs over all its ways and pauses, for each robot of the bands and what it carries on the other ways, and instants."""
        durations = np.array([way.time + goals.pause for way, goals in zip(ways, self.goals.ways, strict=True)])
        starts, period = np.cumsum(durations) - durations, durations.sum()
        cases = [
            np.array([way.robots.index(each) for each in robots])
            for way, robots in zip(ways, self.goals.cases(self.payloads), strict=True)
        ]
        values, times = dict[str, RealArray](), dict[str, RealArray]()
        periodic, more = _left_vibration(self.goals, ways, cases)
        for name in ways[0].values:
            rows = np.array([way.values[name][of_case] for way, of_case in zip(ways, cases, strict=True)])
            if name == "residual":
                # also in the first cycle, which starts at rest
                rows = np.maximum(rows, np.minimum(rows + more, periodic))
            values[name] = rows.max(axis=0)
            if name in ROOTS:
                # squares of all ways and pauses, by which motors heat up
                weights = np.array([self._weight(name, each) for each in durations])[:, np.newaxis]
                values[name] = np.sqrt((rows**2 / weights).sum(axis=0) * self._weight(name, period))
            elif name in OF_CYCLE:
                values[name] = rows.sum(axis=0)
            elif name == "time":
                values[name][:] = period
            elif name in ways[0].times:
                # of the cycle
                pairs = zip(starts, ways, cases, strict=True)
                instants = np.array([start + way.times[name][of_case] for start, way, of_case in pairs])
                times[name] = np.take_along_axis(instants, rows.argmax(axis=0)[np.newaxis], axis=0)[0]
        return values, times

    def _judged(self, candidate: Candidate) -> tuple[Values, Values, tuple[Limit, ...]]:
        if candidate.cycle:
            values, times = self._of_cycle(self.of_ways(candidate))
        else:
            prepared, joints = candidate.prepared(*self.accuracy), candidate.joints
            runs = ((each, prepared.run(each.changes(self.goals.scene))) for each in self.robots)
            needs = [self._of_run(completed(run, f"{candidate.label} with {each}")) for each, run in runs]
            values, times = (
                {name: np.array([each[name] for each in rows]) for name in rows[0]} for rows in zip(*needs, strict=True)
            )
            # what all robots have in common
            for name, each in zip(("time", *RATES), (joints.duration, *peak_rates(joints)), strict=True):
                values[name] = np.full((len(self.robots), 1), each)
        uses = [*self._uses(values, times, values if candidate.method == "given" else self.given.values)]
        if self.goals.loop is not None:
            # the residual vibration that the scene's controllers leave, with its own payload
            dwell = candidate.scene.trajectory.dwell
            loop = with_learned_torques(self.goals.loop, candidate.joints, dwell)
            found, error = left_in_loop(loop, candidate.joints, dwell)
            limit = replace(self.goals.limits["residual"], figure="loop_residual")
            uses.append(limit.used(found, f"loop, {loop.payload.mass:g} kg, {error}"))
        return values, times, tuple(uses)

    def _of_run(self, run: Run) -> tuple[Values, Values]:
        """What the robot of a run needs by figure (1,), or (2,) of both joints, and instants of some figures."""
        recording, end, settings = run.recording, run.plan.duration, settings_for(run)
        motion, (time, torques) = position(recording), sample(segments(recording, TORQUES), 3)
        # the ends of steps are starts of the next ones
        moving = (time <= end) & (np.arange(len(time)) % 3 < 2)
        points, instants = sample(motion, 3)[1][moving], time[moving]
        off, depth = np.abs(self.goals.path.distance(points)[0]), -self.goals.clearance.along(points)
        vibrating = motion.within(end + self.goals.wishes.settled_within, math.inf)
        residual = RecordedSignal(deviation_from_point(vibrating, settings.end_equilibrium))
        # mean squares over the pause of a cycle instead of the dwell, at the end of which the robot rests
        dwell, pause = time[-1] - end, self.goals.pause
        late = time >= end + pause
        more = torques[-1] ** 2 * (pause - dwell) - np.trapezoid(
            torques[late] ** 2 - torques[-1] ** 2, time[late], axis=0
        )

        def rms(name: str, mean: Sequence[float], unit: RealArray | float = 1.0) -> RealArray:
            squares = np.square(mean) * (end + dwell) + more / np.square(unit)
            return np.asarray(np.sqrt(squares * self._weight(name, end + pause)))

        solution = RecordedSolution(recording, settings)
        # speeds are planned, so that there is a power of each motor
        powers = [each for each in map(solution.duty_power, (1, 2)) if each is not None]
        first, second = (each.segments for each in powers)
        both = RecordedPower(first.minus(-second.left, -second.right), 1)
        values: dict[str, Any] = {
            "torque": [solution.torque(joint).peak() for joint in (1, 2)],
            "rms_torque": rms("rms_torque", [solution.duty_torque(joint).root_mean_square() for joint in (1, 2)]),
            "power": [max(each.peak(1), each.peak(-1)) for each in powers],
            "residual": [residual.peak()],
            "energy": [sum(each.energy(1) for each in powers)],
            "supply_power": [both.peak(1)],
            "regenerated_power": [both.peak(-1)],
            "regenerated_energy": [both.energy(-1)],
            "off_path": [off.max()],
            "clearance": [depth.max()],
        }
        if loads := motor_loads(run):
            use = [{margin.name: margin.use for margin in load.margins} for load in loads]
            unit = np.array([load.motor.gear_ratio * load.motor.continuous_torque for load in loads])
            values["motor_torque"] = [max(each["peak torque"], each.get("torque at speed", 0.0)) for each in use]
            values["motor_rms_torque"] = rms("motor_rms_torque", [each["RMS torque"] for each in use], unit)
            values["motor_speed"] = [each["speed"] for each in use]
        # forces in elbows and between the legs and the end effector; no stress in rigid links
        if "reaction" in self.goals.limits:
            joints = [f"{place}{leg}" for place in ("elbow", "leg") for leg in (1, 2)]
            sides = (segments(recording, [f"{joint}.reaction.{axis}" for joint in joints]) for axis in "xy")
            x, y = (sample(each, WITHIN)[1] for each in sides)
            values["reaction"] = [np.hypot(x, y).max()]
        if "stress" in self.goals.limits:
            combined = [each.combined.value for each in link_stresses(run) if each.combined is not None]
            values["stress"] = [max(combined, default=0.0)]
        worst = time[np.abs(torques).argmax(axis=0)], instants[[off.argmax()]], instants[[depth.argmax()]]
        return values, dict(zip(("torque", "off_path", "clearance"), worst, strict=True))

    def _weight(self, figure: str, period: float) -> RealArray:
        """What an integral of squares in a period [s] counts for both motors (2,) [1/s], see `weight_of_squares`."""
        return weight_of_squares(figure, period, self.goals.drives)[0]

    def _uses(self, values: Values, times: Values, usual: Values) -> Iterator[Limit]:
        """How close a motion comes to each limit, relative ones by what the given motion needs, and where."""
        for limit in self.goals.limits.values():
            name, need = limit.figure, values[limit.figure]
            if limit.is_relative:
                beyond = np.where(need > 0.0, np.inf, 0.0)
                need = np.divide(need, usual[name], out=beyond, where=usual[name] != 0.0)
            place = np.unravel_index(need.argmax(), need.shape)
            value, joint = float(need[place]), f"joint {place[1] + 1}, " * (need.shape[1] > 1)
            time = f", {times[name][place]:.4g} s" if name in times else ""
            # without a keep-out region there is no depth in it; on its outline it is 0
            if value != -math.inf:
                yield limit.used(max(value, 0.0), WHOLE.get(name, f"{joint}{self.robots[place[0]]}{time}"))


def _left_vibration(goals: Goals, ways: Sequence[Assessment], cases: Sequence[NDArray[np.intp]]) -> RealArray:
    """Bounds (2, W, C, 1) [m] of each way's residual vibration in the periodic motion, and of its difference from that from rest."""
    starts, ends = list[Sequence[Rest]](), list[ResidualVibration]()
    states, transfers = list[RealArray](), list[RealArray]()
    for of_way, way in zip(goals.ways, ways, strict=True):
        motion, robots = way.candidate.joints, [each.robot(of_way.scene) for each in way.robots]
        first, last = motion.evaluate([0.0, motion.duration], 0, "right")[0]
        response = ElasticResponse(robots, first, max(STEPS, len(motion.breakpoints) - 1))
        references = np.hstack(list(motion.evaluate(response.fractions * motion.duration, 2, "left")))
        starts.append(response.starts)
        ends.append(ResidualVibration(response.models, last))
        states.append(ends[-1].away(response.respond(references, motion.duration).end))
        transfers.append(response.transfer(motion.duration))
    left = LeftVibration(starts, [end.rests for end in ends], [each.pause for each in goals.ways], cases)
    left.renew(transfers)
    pairs = zip(ends, cases, left.periodic(states), states, strict=True)
    found = [[bounds(end.matrices[k], each) for each in (now, now - own[k])] for end, k, now, own in pairs]
    # where it grows from cycle to cycle, after many
    grown = np.maximum(left.growth, 1.0)[:, np.newaxis] ** CYCLES
    return np.asarray(np.array(found).swapaxes(0, 1)[..., np.newaxis] * grown)
