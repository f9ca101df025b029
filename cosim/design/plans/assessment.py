"""What a planned motion is worth: the FMU's runs over the bands, against the limits and the given motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from flexfmu.cosim.control.blocks.code import CompiledAtPoints
from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.goals import MET, RATES, Goals, Variation, peak_rates
from flexfmu.cosim.design.plans.sampled_loop import loop_run, tracking_error, with_learned_torques
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.metric import Metric, RunMetrics
from flexfmu.cosim.experiment.planning import plan, plan_own
from flexfmu.cosim.experiment.scene_loop import loop_of, own_loop
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import joint_speed, product
from flexfmu.cosim.metrics.motors import motor_loads
from flexfmu.cosim.metrics.segments import Analysis, HermiteSegments
from flexfmu.cosim.metrics.signals import TORQUES, segments
from flexfmu.cosim.metrics.stress import link_stresses
from flexfmu.model.reference_design import optimal_control
from flexfmu.model.reference_design.elastic_response import ElasticResponse
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.sources import OwnMotion, as_trajectory
from flexfmu.trajectories.table import read_table
from flexfmu.trajectories.trajectory import Trajectory

Method = Literal["given", "search", "flexible references", "optimal control", "csv"]
"""Where a candidate comes from."""

STEP, TOLERANCE = 2e-4, 1e-8
"""Communication step [s] and tolerance of the runs that judge."""

SAME_PLACE = 1e-5
"""Distance [m] within which a user's motion starts and ends where the scene's does."""

JUDGED = 25
"""Payloads of the band for which every motion is judged."""

INSTANTS = 4001
"""Instants at which references are examined."""

STEPS = 300
"""Steps of the integration that tells what a way leaves in the next."""

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
        ways: the motions of a cycle; empty for a single motion. The scene is that of the first one.
    """

    label: str
    method: Method
    scene: Scene
    trajectory: Trajectory | None = None
    ways: tuple[Candidate, ...] = ()

    @property
    def content(self) -> Mapping[str, Any]:
        """What tells the motion from others: keys of the scene, and samples of its own references."""
        if self.ways:
            return {"ways": [each.content for each in self.ways]}
        own = self.trajectory
        return {
            **about_scene(self.scene),
            "method": self.method,
            "references": None if own is None else own.evaluate(np.linspace(0.0, own.duration, SAMPLES), 2, "left"),
        }

    @property
    def joints(self) -> Trajectory:
        """Its references of the joints, with shapers.

        Raises:
            TrajectoryError: the motion isn't feasible.
        """
        own = self.trajectory
        return (loop_of(self.scene) if own is None else own_loop(self.scene, own)).motion.joints

    def prepared(self, *, tolerance: float = TOLERANCE, step: float = STEP) -> PreparedScene:
        """The candidate, ready for runs.

        Raises:
            TrajectoryError: the motion isn't feasible.
        """
        loop = None if self.trajectory is None else own_loop(self.scene, self.trajectory)
        scene = self.scene if loop is None else loop.motion.scene
        return PreparedScene(scene, loop=loop, communication_step=step, tolerance=tolerance)


def file_candidate(scene: Scene, path: Path) -> Candidate:
    """A user's motion from a CSV file, of the joints or the end effector, to be judged beside those found.

    Raises:
        TrajectoryError: the file can't be read, or its motion can't be used; the message names line, column and value.
        InputError: the motion starts or ends elsewhere than the scene's.
    """
    return own_candidate(scene, path.name, read_table(path).trajectory())


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


@dataclass(frozen=True, eq=False)
class Peaks:
    """What a run of one robot needs; pairs are joints.

    Attributes:
        variation: the robot.
        torque, rms_torque, power: largest magnitudes [N.m], [N.m], [W].
        torque_time: instants of the largest torques [s].
        residual: largest distance from the rest position after the motion [m].
        energy: mechanical energy that the motors give, without what they take back [J].
        supply_power, regenerated_power: largest power of both motors together, into the robot and out of it [W].
        regenerated_energy: what flows out of it [J].
        motor_torque, motor_rms_torque, motor_speed: of the shafts, relative to what the motors can: the torque at its speed, the RMS torque
            that heats them as much; 0 without a section `motor`.
        off_path: largest distance of the end effector from the given path [m], and when [s].
        clearance: smallest distance to the keep-out region [m], and when [s].
        reaction: largest force in a joint [N]; NaN if it isn't limited.
        stress: largest stress of a link [Pa]; NaN if it isn't limited.
    """

    variation: Variation
    torque: tuple[float, float]
    torque_time: tuple[float, float]
    rms_torque: tuple[float, float]
    power: tuple[float, float]
    residual: float
    energy: float
    supply_power: float
    regenerated_power: float
    regenerated_energy: float
    motor_torque: tuple[float, float]
    motor_rms_torque: tuple[float, float]
    motor_speed: tuple[float, float]
    off_path: tuple[float, float]
    clearance: tuple[float, float]
    reaction: float
    stress: float


FIGURES: Mapping[str, tuple[str, str]] = {
    "time": ("Duration with shapers, without the dwell", "s"),
    "residual": ("Largest residual vibration", "m"),
    "torque": ("Largest torque", "N.m"),
    "rms_torque": ("Largest RMS torque", "N.m"),
    "power": ("Largest power of a motor", "W"),
    "supply_power": ("Largest power of both motors", "W"),
    "regenerated_power": ("Largest power that flows back from both motors", "W"),
    "energy": ("Largest energy of a run", "J"),
    "off_path": ("Largest distance from the given path", "m"),
    "jerk": ("Largest jerk of a joint's references", "rad/s3"),
    "clearance": ("Smallest distance to the keep-out region", "m"),
}
"""Figure of an assessment → label and SI unit."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """A candidate's figures, and its use of each limit.

    Attributes:
        candidate: the motion.
        time: duration with shapers, without the dwell [s].
        peaks: what each robot within the bands needs.
        references: largest speed, acceleration and jerk of the joint references [rad/s, rad/s2, rad/s3].
        uses: every limit with what is used of it, the residual and the clearance included.
    """

    candidate: Candidate
    time: float
    peaks: tuple[Peaks, ...]
    references: tuple[float, float, float]
    uses: tuple[Limit, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether it keeps to all limits."""
        return all(use.met for use in self.uses)

    @property
    def excess(self) -> float:
        """The largest share of a limit that it misses; 0 if it keeps to all."""
        shares = (use.share for use in self.uses if not use.met)
        return max((math.inf if math.isnan(each) else each for each in shares), default=0.0)

    @property
    def residual(self) -> float:
        """Worst residual vibration [m]."""
        return max(each.residual for each in self.peaks)

    @property
    def energy(self) -> float:
        """Largest energy of a run [J]."""
        return max(each.energy for each in self.peaks)

    @property
    def torque(self) -> float:
        """Largest torque [N.m]."""
        return max(max(each.torque) for each in self.peaks)

    @property
    def rms_torque(self) -> float:
        """Largest root mean square of a torque [N.m]."""
        return max(max(each.rms_torque) for each in self.peaks)

    @property
    def power(self) -> float:
        """Largest power of a motor [W]."""
        return max(max(each.power) for each in self.peaks)

    @property
    def supply_power(self) -> float:
        """Largest power of both motors together into the robot [W]."""
        return max(each.supply_power for each in self.peaks)

    @property
    def regenerated_power(self) -> float:
        """Largest power of both motors together out of the robot [W]."""
        return max(each.regenerated_power for each in self.peaks)

    @property
    def off_path(self) -> float:
        """Largest distance of the end effector from the given path [m]."""
        return max(each.off_path[0] for each in self.peaks)

    @property
    def jerk(self) -> float:
        """Largest jerk of a joint's references [rad/s³]."""
        return self.references[2]

    @property
    def clearance(self) -> float:
        """Smallest distance to the keep-out region [m], negative within it."""
        return min(each.clearance[0] for each in self.peaks)

    @cached_property
    def torque_ratio(self) -> float:
        """Worst ratio of peak torques to the given motion's; NaN for the given motion itself."""
        return next((use.value for use in self.uses if use.name == "torque ratio"), math.nan)

    @property
    def metrics(self) -> RunMetrics:
        """Its figures with units and labels, the worst within the bands."""
        found = {
            name: Metric(float(getattr(self, name)), unit, name=name, label=label, description=f"{label}.")
            for name, (label, unit) in FIGURES.items()
        }
        return RunMetrics(self.candidate.label, lambda companions, names: found)


Judged = tuple[float, tuple[Peaks, ...], tuple[float, float, float], tuple[Limit, ...]]
"""What a journal has of an assessment."""


class Judge:
    """Assesses candidates of the same goals by runs of the FMU.

    Args:
        goals: limits, bands and clearance.
        payloads: number of payloads within their band.
        journal: where assessments are kept.
    """

    def __init__(self, goals: Goals, payloads: int = JUDGED, journal: WorkJournal = NOWHERE) -> None:
        self.goals, self.variations, self.journal = goals, goals.variations(payloads), journal
        self._payloads = payloads
        self._path = goals.trace
        self._tree = cKDTree(self._path)

    @cached_property
    def given(self) -> Assessment:
        """The given motion."""
        ways = tuple(Candidate("given", "given", each.scene, each.own) for each in self.goals.ways)
        return self.assess(Candidate("given", "given", self.goals.scene, self.goals.own, ways), given=True)

    def assess(self, candidate: Candidate, *, given: bool = False) -> Assessment:
        """Run a candidate over the bands.

        Raises:
            TrajectoryError: the motion isn't feasible.
            ResultsError: a run failed.
        KeyboardInterrupt: after Ctrl-C, which ends a run early.
        """
        place = len(self.variations), "given" if given else candidate
        if place not in self.goals.judged:
            key = ["judged", len(self.variations), candidate.content]
            self.goals.judged[place] = self.journal.kept(key, Judged, lambda: self._judged(candidate, given=given))
        return Assessment(candidate, *self.goals.judged[place])

    def of_ways(self, candidate: Candidate, *, given: bool = False) -> tuple[Assessment, ...]:
        """The assessments of each way of a cycle; arguments and errors as for `assess`."""
        judges = [Judge(each, self._payloads, self.journal) for each in self.goals.ways]
        return tuple(
            judge.given if given else judge.assess(way) for judge, way in zip(judges, candidate.ways, strict=True)
        )

    def _of_cycle(self, ways: Sequence[Assessment], candidate: Candidate) -> Assessment:
        """What a cycle is worth: over all its ways and pauses, for each robot of the bands and what it carries on the other ways."""
        pauses = [each.pause or 0.0 for each in self.goals.ways]
        times = [way.time + pause for way, pause in zip(ways, pauses, strict=True)]
        variations = [[peaks.variation for peaks in way.peaks] for way in ways]
        cases = cases_of(variations)
        left = _left_vibration(self.goals, [each.joints for each in candidate.ways], variations, cases)
        found = []
        for case, first in enumerate(variations[int(np.argmax([*map(len, variations)]))]):
            # with instants of the cycle
            each = list[Peaks]()
            for way, of_case, bound, start in zip(ways, cases, left, np.cumsum(times) - times, strict=True):
                # also in the first cycle, which starts at rest
                peaks, (periodic, more) = way.peaks[of_case[case]], bound[:, case].tolist()
                each.append(
                    replace(
                        peaks,
                        torque_time=(float(start) + peaks.torque_time[0], float(start) + peaks.torque_time[1]),
                        residual=max(peaks.residual, min(peaks.residual + more, periodic)),
                        off_path=(peaks.off_path[0], float(start) + peaks.off_path[1]),
                        clearance=(peaks.clearance[0], float(start) + peaks.clearance[1]),
                    )
                )
            torque = [max((peaks.torque[k], peaks.torque_time[k]) for peaks in each) for k in range(2)]
            squares = np.average([np.square(peaks.rms_torque) for peaks in each], axis=0, weights=times)
            motors = np.average(
                [
                    np.square(peaks.motor_rms_torque) / self._heating(time)
                    for peaks, time in zip(each, times, strict=True)
                ],
                axis=0,
                weights=times,
            )
            heat = np.sqrt(motors * self._heating(sum(times)))
            power, motor_torque, motor_speed = (
                np.max([getattr(peaks, name) for peaks in each], axis=0).tolist()
                for name in ("power", "motor_torque", "motor_speed")
            )
            found.append(
                Peaks(
                    first,
                    torque=(torque[0][0], torque[1][0]),
                    torque_time=(torque[0][1], torque[1][1]),
                    rms_torque=(float(squares[0] ** 0.5), float(squares[1] ** 0.5)),
                    power=(power[0], power[1]),
                    residual=max(peaks.residual for peaks in each),
                    energy=sum(peaks.energy for peaks in each),
                    supply_power=max(peaks.supply_power for peaks in each),
                    regenerated_power=max(peaks.regenerated_power for peaks in each),
                    regenerated_energy=sum(peaks.regenerated_energy for peaks in each),
                    motor_torque=(motor_torque[0], motor_torque[1]),
                    motor_rms_torque=(float(heat[0]), float(heat[1])),
                    motor_speed=(motor_speed[0], motor_speed[1]),
                    off_path=max(peaks.off_path for peaks in each),
                    clearance=min(peaks.clearance for peaks in each),
                    reaction=max(peaks.reaction for peaks in each),
                    stress=max(peaks.stress for peaks in each),
                )
            )
        speed, acceleration, jerk = np.max([way.references for way in ways], axis=0).tolist()
        return Assessment(candidate, sum(times), tuple(found), (speed, acceleration, jerk))

    def _judged(self, candidate: Candidate, *, given: bool) -> Judged:
        if candidate.ways:
            cycle = self._of_cycle(self.of_ways(candidate, given=given), candidate)
            uses = tuple(self._uses(cycle, cycle if given else self.given))
            return cycle.time, cycle.peaks, cycle.references, uses
        prepared = candidate.prepared()
        found = []
        for variation in self.variations:
            run = prepared.run(variation.changes(self.goals.scene))
            if run.outcome is Outcome.INTERRUPTED:
                raise KeyboardInterrupt
            if not run.completed:
                raise ResultsError(f"{candidate.label} with {variation}: {run.message}")
            found.append(self._peaks(run, variation))
        joints = run.plan.joints
        speed, acceleration, jerk = peak_rates(joints, INSTANTS).tolist()
        assessment = Assessment(candidate, joints.duration, tuple(found), (speed, acceleration, jerk))
        uses = tuple(self._uses(assessment, assessment if given else self.given))
        if self.goals.loop is not None:
            uses = *uses, self._in_the_loop(self.goals.loop, candidate)
        return assessment.time, assessment.peaks, assessment.references, uses

    def _in_the_loop(self, scene: Scene, candidate: Candidate) -> Limit:
        """The residual vibration that the scene's controllers leave, with its own payload."""
        dwell = candidate.scene.trajectory.dwell
        run = loop_run(with_learned_torques(scene, candidate.joints, dwell), candidate.joints, dwell)
        where = f"loop, {scene.payload.mass:g} kg, tracking error {1e3 * tracking_error(run):.3g} mrad"
        found = float(run.metrics["residual_vibration_amplitude"])
        return Limit("loop_residual", self.goals.wishes.residual, "m", rounding=MET).used(found, where)

    def _peaks(self, run: Run, variation: Variation) -> Peaks:
        metrics, recording, end = run.metrics, run.recording, run.plan.duration
        torques = [recording[f"joint{joint}.torque"].values for joint in (1, 2)]
        moving = recording.time <= end
        points = np.column_stack([recording[f"end_effector.position.{axis}"].values for axis in "xy"])
        off, clear = (
            self._off_path(points[moving]),
            self.goals.clearance.along(points[moving], self.goals.wishes.margin),
        )

        def power(joint: int) -> float:
            return max(float(metrics[f"{name}_{joint}"]) for name in ("peak_power", "peak_regenerated_power"))

        # from when on the vibration counts
        residual = float(metrics["residual_vibration_amplitude"])
        if wait := self.goals.wishes.settled_within:
            rest = points[-1]
            residual = float(np.hypot(*(points[recording.time >= end + wait] - rest).T).max())
        # over the pause of a cycle instead of the dwell, at the end of which the robot rests
        rms, dwell = np.array([float(metrics[f"rms_torque_{joint}"]) for joint in (1, 2)]), recording.time[-1] - end
        pause, holding = (
            (dwell if self.goals.pause is None else self.goals.pause),
            np.array([each[-1] for each in torques]),
        )
        rms = np.sqrt((rms**2 * (end + dwell) + holding**2 * (pause - dwell)) / (end + pause))
        motor = np.zeros((3, 2))
        for k, load in enumerate(motor_loads(run)):
            use = {margin.name: margin.use for margin in load.margins}
            at_rest = holding[k] / load.motor.gear_ratio / load.motor.continuous_torque
            square = (use["RMS torque"] ** 2 * (end + dwell) + at_rest**2 * (pause - dwell)) / (end + pause)
            motor[:, k] = max(use["peak torque"], use.get("torque at speed", 0.0)), math.sqrt(square), use["speed"]
        motor[1] *= np.sqrt(self._heating(end + pause))
        motor_torque, motor_rms, motor_speed = ((float(one), float(other)) for one, other in motor)
        # forces in elbows and between the legs and the end effector; no stress in rigid links
        reaction = stress = math.nan
        if "reaction" in self.goals.limits:
            names = [f"{place}{leg}.reaction" for place in ("elbow", "leg") for leg in (1, 2)]
            forces = [np.hypot(*(recording[f"{name}.{axis}"].values for axis in "xy")) for name in names]
            reaction = max(float(force.max()) for force in forces)
        if "stress" in self.goals.limits:
            combined = [each.combined.value for each in link_stresses(run) if each.combined is not None]
            stress = max(combined, default=0.0)
        return Peaks(
            variation,
            (float(metrics["peak_torque_1"]), float(metrics["peak_torque_2"])),
            tuple(float(recording.time[np.abs(each).argmax()]) for each in torques),  # type: ignore[arg-type]
            (float(rms[0]), float(rms[1])),
            (power(1), power(2)),
            residual,
            float(metrics["positive_energy_1"]) + float(metrics["positive_energy_2"]),
            *_both_powers(recording, run.plan.joints),
            motor_torque,
            motor_rms,
            motor_speed,
            (float(off.max()), float(recording.time[off.argmax()])),
            (float(clear.min()), float(recording.time[clear.argmin()])),
            reaction,
            stress,
        )

    def _heating(self, period: float) -> RealArray:
        """What a mean square over a period [s] counts for the temperature of both motors (2,), see `Motor.heating`."""
        drives = self.goals.drives
        return np.ones(2) if drives is None else period * np.array([each.heating(period)[0] for each in drives.motors])

    def _off_path(self, points: RealArray) -> RealArray:
        """Distances (N,) [m] of points from the given path."""
        _, nearest = self._tree.query(points)
        found = np.full(len(points), np.inf)
        for shift in (-1, 0):
            first = np.clip(nearest + shift, 0, len(self._path) - 2)
            side = self._path[first + 1] - self._path[first]
            away = points - self._path[first]
            along = np.clip(np.einsum("nj,nj->n", away, side) / np.einsum("nj,nj->n", side, side), 0.0, 1.0)
            found = np.minimum(found, np.hypot(*(away - along[:, None] * side).T))
        return found

    def _uses(self, found: Assessment, given: Assessment) -> Iterator[Limit]:
        """How close the motion comes to each limit, and where."""
        wishes = self.goals.wishes
        worst = max(found.peaks, key=lambda each: each.residual)
        yield Limit("residual", wishes.residual, "m", rounding=MET).used(worst.residual, str(worst.variation))
        nearest = min(found.peaks, key=lambda each: each.clearance[0])
        distance, instant = nearest.clearance
        if math.isfinite(distance):
            # as a depth: 0 on the outline
            where = f"{instant:.4g} s, {nearest.variation}"
            yield Limit("clearance", wishes.margin, "m", rounding=MET).used(max(-distance, 0.0), where)
        for limit in self.goals.limits.values():
            rows = needs(limit.figure, found, given)
            value, where = max((need / usual if limit.is_relative else need, where) for need, usual, where in rows)
            yield limit.used(value, where)
        if wishes.duration is not None:
            yield Limit("time", wishes.duration, "s", rounding=MET).used(found.time, "whole motion")


def cases_of(variations: Sequence[Sequence[Variation]]) -> list[NDArray[np.intp]]:
    """Index (C,) of the robot of each way for every case: those of the way with most robots, and on other ways as near in payload as can be."""
    cases, found = max(variations, key=len), list[NDArray[np.intp]]()
    heaviest = [max(each.payload for each in robots) or 1.0 for robots in variations]
    for robots, heavy in zip(variations, heaviest, strict=True):
        most = max(each.payload for each in cases) or 1.0
        away = [
            [
                abs(case.payload / most - robot.payload / heavy)
                + 1e3 * (abs(case.stiffness - robot.stiffness) + abs(case.damping - robot.damping))
                for robot in robots
            ]
            for case in cases
        ]
        found.append(np.argmin(away, axis=1))
    return found


def _left_vibration(
    goals: Goals,
    motions: Sequence[Trajectory],
    variations: Sequence[Sequence[Variation]],
    cases: Sequence[NDArray[np.intp]],
) -> RealArray:
    """Bounds (W, 2, C) [m] of each way's residual vibration in the periodic motion, and of its difference from that from rest."""
    ends, states, transfers = list[optimal_control.ResidualVibration](), list[RealArray](), list[RealArray]()
    for way, motion, robots in zip(goals.ways, motions, variations, strict=True):
        first, last = motion.evaluate([0.0, motion.duration], 0, "right")[0]
        changes = [each.changes(way.scene) for each in robots]
        response = ElasticResponse(way.scene, changes, first, STEPS, CompiledAtPoints)
        references = np.hstack(list(motion.evaluate(response.fractions * motion.duration, 2, "left")))
        ends.append(optimal_control.ResidualVibration([response.model], last))
        states.append(ends[-1].away(response.respond(references, motion.duration).end))
        transfers.append(response.transfer(motion.duration))
    left = optimal_control.LeftVibration([end.rests for end in ends], [each.pause or 0.0 for each in goals.ways], cases)
    left.renew(transfers)
    pairs = zip(ends, cases, left.periodic(states), states, strict=True)
    return np.array(
        [
            [optimal_control.bounds(end.matrices[k], each) for each in (periodic, periodic - own[k])]
            for end, k, periodic, own in pairs
        ]
    )


def _both_powers(recording: Recording, joints: Trajectory) -> tuple[float, float, float]:
    """Largest power of both motors together into the robot, and out of it [W], and the energy that flows out [J]."""
    powers = []
    for joint in range(2):
        speed = joint_speed(recording, joint, joints)
        assert speed is not None  # it is planned
        powers.append(product(segments(recording, TORQUES[joint : joint + 1]), speed))
    one, other = powers
    into, out, _, back, *_ = Analysis(
        HermiteSegments(one.start, one.end, one.left + other.left, one.right + other.right)
    ).parts()
    return into, out, back


def needs(figure: str, found: Assessment, given: Assessment) -> Iterator[tuple[float, float, str]]:
    """What a motion and the given one need of a figure, for each robot and joint, and where."""
    if figure in RATES:
        k = RATES.index(figure)
        yield found.references[k], given.references[k], "references"
        return
    for each, own in zip(found.peaks, given.peaks, strict=True):
        need, usual = getattr(each, figure), getattr(own, figure)
        if figure == "off_path":
            yield need[0], usual[0], f"{need[1]:.4g} s, {each.variation}"
        elif isinstance(need, tuple):
            for k in range(2):
                when = f", {each.torque_time[k]:.4g} s" if figure == "torque" else ""
                yield need[k], usual[k], f"joint {k + 1}, {each.variation}{when}"
        else:
            yield need, usual, str(each.variation)
