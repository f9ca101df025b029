"""What a planned motion is worth: the FMU's runs over the bands, against the limits and the given motion."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.code import CompiledAtPoints
from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.goals import MET, RATES, Goals, Variation, peak_rates
from flexfmu.cosim.design.plans.sampled_loop import completed, loop_run, tracking_error, with_learned_torques
from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.metric import Metric, RunMetrics
from flexfmu.cosim.experiment.planning import plan, plan_own
from flexfmu.cosim.experiment.scene_loop import loop_of, own_loop
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import MetricDefinition
from flexfmu.cosim.metrics.metrics import joint_speed, product
from flexfmu.cosim.metrics.motors import motor_loads
from flexfmu.cosim.metrics.segments import Analysis, HermiteSegments
from flexfmu.cosim.metrics.signals import TORQUES, segments
from flexfmu.cosim.metrics.stress import link_stresses
from flexfmu.model.reference_design import optimal_control
from flexfmu.model.reference_design.elastic_response import ElasticResponse
from flexfmu.model.reference_design.loads import OF_CYCLE, ROOTS, weight_of_squares
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.sources import OwnMotion, as_trajectory
from flexfmu.trajectories.trajectory import Trajectory

Method = Literal["given", "search", "flexible references", "optimal control", "csv"]
"""Where a candidate comes from."""

STEP, TOLERANCE = 2e-4, 1e-8
"""Communication step [s] and tolerance of the runs that judge."""

SAME_PLACE = 1e-5
"""Distance [m] within which a user's motion starts and ends where the scene's does."""

JUDGED = 25
"""Payloads of the band for which every motion is judged."""

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
        is_rough: whether it was planned for few robots, as a start for a motion for all, which is preferred.
    """

    label: str
    method: Method
    scene: Scene
    trajectory: Trajectory | None = None
    ways: tuple[Candidate, ...] = ()
    is_rough: bool = False

    @property
    def content(self) -> Mapping[str, Any]:
        """What tells the motion from others: keys of the scene, and samples of its own references."""
        if self.ways:
            return {"ways": [each.content for each in self.ways]}
        own = self.trajectory
        references = None if own is None else own.evaluate(np.linspace(0.0, own.duration, SAMPLES), 2, "left")
        return about_scene(self.scene) | {"method": self.method, "references": references}

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
    """What a run of one robot needs.

    Its values are by figure, one or one for each joint: ``time`` [s] with shapers, without the dwell; ``torque``, ``rms_torque`` [N.m] and
    ``power`` [W], largest magnitudes; ``residual`` [m], the largest distance from the rest position after the motion; ``energy`` [J] that the
    motors give, without what they take back; ``supply_power`` and ``regenerated_power`` [W] of both motors together, into the robot and out
    of it, and ``regenerated_energy`` [J] that flows out; ``off_path`` [m], the largest distance of the end effector from the given path;
    ``clearance`` [m], the largest depth within the keep-out region, negative outside; ``speed``, ``acceleration`` and ``jerk`` of the joint
    references; with a section `motor` ``motor_torque``, ``motor_rms_torque`` and ``motor_speed`` of the shafts relative to what the motors
    can, the torque at its speed, the RMS torque that heats them as much; and where they are limited ``reaction`` [N], the largest force in
    a joint, and ``stress`` [Pa] of a link.

    Attributes:
        variation: the robot.
        values: of each figure.
        times: instants of some of them [s].
    """

    variation: Variation
    values: Mapping[str, tuple[float, ...]]
    times: Mapping[str, tuple[float, ...]]


FIGURES: Mapping[str, MetricDefinition] = {
    "time": MetricDefinition("Total time", "s", "Duration with shapers, without the dwell."),
    "residual": MetricDefinition(
        "Residual vibration", "m", "Largest distance from rest.", display=("µm", lambda value: 1e6 * value)
    ),
    "torque": MetricDefinition("Peak torque", "N.m", "Largest torque of a motor."),
    "rms_torque": MetricDefinition("RMS torque", "N.m", "Largest RMS torque of a motor, over motion and standstill."),
    "power": MetricDefinition("Power of a motor", "W", "Largest power of a motor, into the robot or back."),
    "supply_power": MetricDefinition("Power of the supply", "W", "Largest power of both motors together."),
    "regenerated_power": MetricDefinition("Power back", "W", "Largest power out of both motors together."),
    "energy": MetricDefinition("Energy", "J", "Energy that the motors give, without what they take back."),
    "off_path": MetricDefinition("Off the path", "m", "Largest distance from the given path."),
    "speed": MetricDefinition("Joint speed", "rad/s", "Largest speed of a joint reference."),
    "acceleration": MetricDefinition("Joint acceleration", "rad/s2", "Largest acceleration of a joint reference."),
    "jerk": MetricDefinition("Joint jerk", "rad/s3", "Largest jerk of a joint reference."),
    "clearance": MetricDefinition("Distance to the keep-out region", "m", "Smallest distance to the keep-out region."),
}
"""The figures of an assessment."""


def heading(figure: str) -> str:
    """Heading of a column, with the unit."""
    text = figure.replace("_", " ").replace("rms", "RMS")
    return f"{text[0].upper()}{text[1:]} [{FIGURES[figure].display_unit}]"


def shown(figure: str, value: float) -> str:
    """A value [SI] as it is shown."""
    return f"{FIGURES[figure].displayed(value):.4g}"


WHOLE: Mapping[str, str] = {"time": "whole motion", **dict.fromkeys(RATES, "references")}
"""Figures that robots and joints have in common → where they are."""


def _worst(figure: str) -> Any:
    """The property of an assessment that is the worst value of a figure."""
    info = FIGURES[figure]
    return property(lambda self: self.worst(figure), doc=f"{info.description[:-1]} [{info.unit}].")


@dataclass(frozen=True, eq=False)
class Assessment:
    """A candidate's figures, and its use of each limit.

    Attributes:
        candidate: the motion.
        peaks: what each robot within the bands needs.
        uses: every limit with what is used of it.
    """

    candidate: Candidate
    peaks: tuple[Peaks, ...]
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

    def worst(self, figure: str) -> float:
        """The worst value of a figure of `Peaks` within the bands, of both joints."""
        most = max(value for each in self.peaks for value in each.values[figure])
        return -most if figure == "clearance" else most

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
        """Label, method, all of `FIGURES`, the torque ratio, and whether it keeps to all limits."""
        names = {"motion": self.candidate.label, "method": self.candidate.method}
        figures = {name: self.worst(name) for name in FIGURES}
        return names | figures | {"torque_ratio": self.torque_ratio, "feasible": bool(self.feasible)}

    @property
    def metrics(self) -> RunMetrics:
        """Its figures with units and labels, the worst within the bands."""
        found = {
            name: Metric(self.worst(name), each.unit, name=name, label=each.label, description=each.description)
            for name, each in FIGURES.items()
        }
        return RunMetrics(self.candidate.label, lambda companions, names: found)


Judged = tuple[tuple[Peaks, ...], tuple[Limit, ...]]
"""What a journal has of an assessment."""


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
        payloads: number of payloads within their band.
        journal: where assessments are kept.
    """

    def __init__(self, goals: Goals, payloads: int = JUDGED, journal: WorkJournal = NOWHERE) -> None:
        self.goals, self.variations, self.journal = goals, goals.variations(payloads), journal
        self._payloads = payloads

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
            # runs and their metrics refer to each other, and recordings are large
            gc.collect()
        return Assessment(candidate, *self.goals.judged[place])

    def of_ways(self, candidate: Candidate, *, given: bool = False) -> tuple[Assessment, ...]:
        """The assessments of each way of a cycle; arguments and errors as for `assess`."""
        judges = [Judge(each, self._payloads, self.journal) for each in self.goals.ways]
        pairs = zip(judges, candidate.ways, strict=True)
        return tuple(judge.given if given else judge.assess(way) for judge, way in pairs)

    def _of_cycle(self, ways: Sequence[Assessment], candidate: Candidate) -> Assessment:
        """What a cycle is worth: over all its ways and pauses, for each robot of the bands and what it carries on the other ways."""
        pauses = [each.pause or 0.0 for each in self.goals.ways]
        times = [way.time + pause for way, pause in zip(ways, pauses, strict=True)]
        variations = [[peaks.variation for peaks in way.peaks] for way in ways]
        cases, starts = cases_of(variations), np.cumsum(times) - times
        left = _left_vibration(self.goals, [each.joints for each in candidate.ways], variations, cases)
        found = []
        for case, first in enumerate(variations[int(np.argmax([*map(len, variations)]))]):
            each = [way.peaks[of_case[case]] for way, of_case in zip(ways, cases, strict=True)]
            values, instants = dict[str, tuple[float, ...]](), dict[str, tuple[float, ...]]()
            for name in each[0].values:
                rows = np.array([peaks.values[name] for peaks in each])
                if name == "residual":
                    # also in the first cycle, which starts at rest
                    periodic, more = left[:, :, case].T[..., np.newaxis]
                    rows = np.maximum(rows, np.minimum(rows + more, periodic))
                whole = rows.max(axis=0)
                if name in ROOTS:
                    heating = [self._heating(name, time) for time in times]
                    whole = np.average(rows**2 / heating, axis=0, weights=times) * self._heating(name, sum(times))
                    whole = np.sqrt(whole)
                elif name in OF_CYCLE:
                    whole = rows.sum(axis=0)
                elif name == "time":
                    whole = np.array([sum(times)])
                elif name in each[0].times:
                    # of the cycle
                    ends = np.array([start + np.array(p.times[name]) for start, p in zip(starts, each, strict=True)])
                    index = np.abs(rows - whole).argmin(axis=0)
                    instants[name] = (*ends[index, np.arange(len(index))].tolist(),)
                values[name] = (*whole.tolist(),)
            found.append(Peaks(first, values, instants))
        return Assessment(candidate, tuple(found))

    def _judged(self, candidate: Candidate, *, given: bool) -> Judged:
        if candidate.ways:
            assessment = self._of_cycle(self.of_ways(candidate, given=given), candidate)
        else:
            prepared, found, joints = candidate.prepared(), list[Peaks](), candidate.joints
            # what all robots have in common
            rates = zip(RATES, peak_rates(joints)[:, np.newaxis], strict=True)
            common = {"time": [joints.duration], **dict(rates)}
            for each in self.variations:
                run = completed(prepared.run(each.changes(self.goals.scene)), f"{candidate.label} with {each}")
                found.append(self._peaks(run, each, common))
            assessment = Assessment(candidate, tuple(found))
        uses = [*self._uses(assessment, assessment if given else self.given)]
        if self.goals.loop is not None:
            uses.append(self._in_the_loop(self.goals.loop, candidate))
        return assessment.peaks, tuple(uses)

    def _in_the_loop(self, scene: Scene, candidate: Candidate) -> Limit:
        """The residual vibration that the scene's controllers leave, with its own payload."""
        dwell = candidate.scene.trajectory.dwell
        run = loop_run(with_learned_torques(scene, candidate.joints, dwell), candidate.joints, dwell)
        where = f"loop, {scene.payload.mass:g} kg, tracking error {1e3 * tracking_error(run):.3g} mrad"
        found = float(run.metrics["residual_vibration_amplitude"])
        return Limit("loop_residual", self.goals.wishes.residual, "m", rounding=MET).used(found, where)

    def _peaks(self, run: Run, variation: Variation, common: Mapping[str, Any]) -> Peaks:
        metrics, recording, end = run.metrics, run.recording, run.plan.duration
        time, torques = recording.time, [recording[f"joint{joint}.torque"].values for joint in (1, 2)]
        points = np.column_stack([recording[f"end_effector.position.{axis}"].values for axis in "xy"])
        moving, vibrating = time <= end, time >= end + self.goals.wishes.settled_within
        off = np.abs(self.goals.path.distance(points[moving])[0])
        depth = -self.goals.clearance.along(points[moving], self.goals.wishes.margin)

        def of_joints(name: str) -> RealArray:
            return np.array([float(metrics[f"{name}_{joint}"]) for joint in (1, 2)])

        residual = float(metrics["residual_vibration_amplitude"])
        if self.goals.wishes.settled_within:
            residual = float(np.hypot(*(points[vibrating] - points[-1]).T).max())
        # mean squares over the pause of a cycle instead of the dwell, at the end of which the robot rests
        dwell = time[-1] - end
        pause = dwell if self.goals.pause is None else self.goals.pause
        late = time >= end + pause
        swings = [np.trapezoid(each[late] ** 2 - each[-1] ** 2, time[late]) for each in torques]
        more = [each[-1] ** 2 * (pause - dwell) for each in torques] - np.array(swings)

        def rms(mean: RealArray, unit: RealArray | float) -> RealArray:
            return np.asarray(np.sqrt((mean**2 * (end + dwell) + more / np.square(unit)) / (end + pause)))

        values: dict[str, Any] = {
            **common,
            "torque": of_joints("peak_torque"),
            "rms_torque": rms(of_joints("rms_torque"), 1.0),
            "power": np.maximum(of_joints("peak_power"), of_joints("peak_regenerated_power")),
            "residual": [residual],
            "energy": [of_joints("positive_energy").sum()],
            **_both_powers(recording, run.plan.joints),
            "off_path": [off.max()],
            "clearance": [depth.max()],
        }
        if loads := motor_loads(run):
            use = [{margin.name: margin.use for margin in load.margins} for load in loads]
            unit = np.array([load.motor.gear_ratio * load.motor.continuous_torque for load in loads])
            heating = np.sqrt(self._heating("motor_rms_torque", end + pause))
            values["motor_torque"] = [max(each["peak torque"], each.get("torque at speed", 0.0)) for each in use]
            values["motor_rms_torque"] = heating * rms(np.array([each["RMS torque"] for each in use]), unit)
            values["motor_speed"] = [each["speed"] for each in use]
        # forces in elbows and between the legs and the end effector; no stress in rigid links
        if "reaction" in self.goals.limits:
            names = [f"{place}{leg}.reaction" for place in ("elbow", "leg") for leg in (1, 2)]
            forces = [np.hypot(*(recording[f"{name}.{axis}"].values for axis in "xy")) for name in names]
            values["reaction"] = [np.max(forces)]
        if "stress" in self.goals.limits:
            combined = [each.combined.value for each in link_stresses(run) if each.combined is not None]
            values["stress"] = [max(combined, default=0.0)]
        instants = {"torque": [time[np.abs(each).argmax()] for each in torques]}
        instants |= {"off_path": [time[off.argmax()]], "clearance": [time[depth.argmax()]]}
        tables = ({name: tuple(map(float, each)) for name, each in table.items()} for table in (values, instants))
        return Peaks(variation, *tables)

    def _heating(self, figure: str, period: float) -> RealArray:
        """What a mean square over a period [s] counts for the temperature of both motors (2,), see `Motor.heating`."""
        return period * weight_of_squares(figure, period, self.goals.drives)[0]

    def _uses(self, found: Assessment, given: Assessment) -> Iterator[Limit]:
        """How close the motion comes to each limit, and where."""
        for limit in self.goals.limits.values():
            rows, is_relative = needs(limit.figure, found, given), limit.is_relative
            value, where = max((_ratio(need, usual) if is_relative else need, where) for need, usual, where in rows)
            # without a keep-out region there is no depth in it; on its outline it is 0
            if value > -math.inf:
                yield limit.used(max(value, 0.0), where)


def cases_of(variations: Sequence[Sequence[Variation]]) -> list[NDArray[np.intp]]:
    """Index (C,) of the robot of each way for every case: those of the way with most robots, and on other ways as near in payload as can be."""

    def places(robots: Sequence[Variation]) -> RealArray:
        heaviest = max(each.payload for each in robots) or 1.0
        return np.array([(each.payload / heaviest, 1e3 * each.stiffness, 1e3 * each.damping) for each in robots])

    cases = places(max(variations, key=len))[:, np.newaxis]
    return [np.abs(cases - places(robots)).sum(axis=2).argmin(axis=1) for robots in variations]


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
    bounds = optimal_control.bounds
    return np.array([[bounds(end.matrices[k], each) for each in (now, now - own[k])] for end, k, now, own in pairs])


def _both_powers(recording: Recording, joints: Trajectory) -> dict[str, list[float]]:
    """Largest power of both motors together into the robot, and out of it [W], and the energy that flows out [J]."""
    powers = []
    for joint in range(2):
        speed = joint_speed(recording, joint, joints)
        assert speed is not None  # it is planned
        powers.append(product(segments(recording, TORQUES[joint : joint + 1]), speed))
    one, other = powers
    both = HermiteSegments(one.start, one.end, one.left + other.left, one.right + other.right)
    into, out, _, back, *_ = Analysis(both).parts()
    return {"supply_power": [into], "regenerated_power": [out], "regenerated_energy": [back]}


def _ratio(need: float, usual: float) -> float:
    """A need relative to the given motion's; 0 if both need nothing."""
    return need / usual if usual else math.inf if need else 0.0


def needs(figure: str, found: Assessment, given: Assessment) -> Iterator[tuple[float, float, str]]:
    """What a motion and the given one need of a figure, for each robot and joint, and where."""
    for each, own in zip(found.peaks, given.peaks, strict=True):
        values, times = each.values[figure], each.times.get(figure)
        for k, (need, usual) in enumerate(zip(values, own.values[figure], strict=True)):
            joint, time = [f"joint {k + 1}"] * (len(values) > 1), [] if times is None else [f"{times[k]:.4g} s"]
            yield need, usual, WHOLE.get(figure, ", ".join([*joint, str(each.variation), *time]))
