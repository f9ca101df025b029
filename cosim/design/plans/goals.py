"""The wishes for a planned motion, resolved for a scene: limits in SI units, bands and regions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from flexfmu.cosim.control.blocks.code import CompiledAtPoints
from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.clearance import Clearance, Polygon, clearance_of_trace, interpolated, lengths
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.cycles import Reversed
from flexfmu.cosim.experiment.parameters import scene_parameters, scene_with_parameters
from flexfmu.cosim.experiment.planning import MotionPlan, plan, plan_own
from flexfmu.cosim.metrics.metric_table import PLAN_FIGURES
from flexfmu.model.reference_design.elastic_response import RobotVariant, VariantModel
from flexfmu.model.reference_design.loads import Drives
from flexfmu.model.scene.assembly import bases
from flexfmu.model.scene.messages import unit_of
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.plan import PlanLimits, PlanSection, Ratio, TargetSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import spline
from flexfmu.trajectories.trajectory import Trajectory

LEAST_DWELL = 0.25
"""Standstill after the motion and `settled_within` [s], at least, over which the residual vibration is judged."""

TRACE = 601
"""Points of the given motion's trace."""

USUAL: Mapping[str, Ratio] = dict.fromkeys(("torque", "rms_torque", "power"), Ratio(ratio=1.0))
"""Limits where the wishes have none, and the scene no motors."""

OF_MOTORS: Mapping[str, float] = dict.fromkeys(("motor_torque", "motor_rms_torque", "motor_speed"), 1.0)
"""Those of a scene with motors."""

ONCE: Mapping[str, Any] = {"trajectory.way_back": "none", "trajectory.cycles": 1, "trajectory.pause": 0.0}
"""Keys of a motion without its way back."""

LOOP_PARTS = ("controller", "imperfection", "filter", "disturbance")
"""Lists of the scene that motors which follow exactly don't have."""

RATES = ("speed", "acceleration", "jerk")
"""Limits of the joint references, by the order of the derivative."""

MET = 1e-5
"""Relative excess over a limit that counts as rounding."""

NO_LIMIT = 1e9
"""Stands for a limit that isn't set."""

SAME_PLACE = 1e-6
"""Distance [m] below which two places of a cycle are the same."""

GRID = 160
"""Points along each side of the grid on which a way around the regions is looked for."""

FAR, SMOOTHED = 1e3, 61
"""How much longer that grid's ways near regions are, and points over which one is averaged."""

INSTANTS = 4001
"""Instants at which references are examined."""

DAMPING = ("damping.ratio", "damping.rate", "damping.time")
"""Parameters of the FMU that are strengths of the damping."""


@dataclass(frozen=True)
class Variation:
    """A robot within the bands.

    Attributes:
        payload: mass [kg].
        stiffness, damping: factors of Young's modulus and of the damping.
    """

    payload: float
    stiffness: float = 1.0
    damping: float = 1.0

    def changes(self, scene: Scene) -> dict[str, float]:
        """Parameters of the FMU that differ from the scene's."""
        factors = {"material.youngs_modulus": self.stiffness, **dict.fromkeys(DAMPING, self.damping)}
        known = scene_parameters(scene)
        found = {name: factor * known[name] for name, factor in factors.items() if factor != 1.0 and known[name]}
        # an FMU without a payload has no parameter for it
        return found | ({"payload.mass": self.payload} if scene.payload.mass else {})

    def robot(self, scene: Scene) -> RobotVariant:
        """The robot for programmes, of the scene's model."""
        return RobotVariant(scene, self.changes(scene), CompiledAtPoints)

    def of(self, scene: Scene) -> Scene:
        """The scene of this robot."""
        return scene_with_parameters(scene, self.changes(scene))

    def __str__(self) -> str:
        text = f"{self.payload:g} kg"
        text += f", {100 * (self.stiffness - 1):+.0f} % stiffness" if self.stiffness != 1.0 else ""
        return text + (f", {100 * (self.damping - 1):+.0f} % damping" if self.damping != 1.0 else "")


@dataclass(frozen=True)
class Goals:
    """What a plan shall reach, and what it must keep to.

    Attributes:
        scene: the given scene, from a start at rest, with a dwell that shows the residual vibration.
        wishes: its section `plan`.
        limits: by name; ``clearance`` is that of a depth.
        payload: mass that the planned scene has [kg], in the band or not; `scene` has the heaviest of the band in place of none.
        own: the given motion of the joints where it isn't the scene's.
        pause: time at rest after the motion that RMS torques contain [s]: of a cycle, or the given scene's dwell.
        loop: the scene with the controllers that will follow the planned motion; None for motors that follow exactly.
        before: joint references of an earlier plan, of each way, from which optimal control goes on first.
        cycle: the goals of each way of a cycle; empty for a single motion. The goals of a cycle have the scene of its first way.
        regions: where the end effector may go, of another model of the same robot; None for what follows from the wishes.
        judged: what judges of these goals have found, so that none runs a motion again: by number of robots and motion.
    """

    scene: Scene
    wishes: PlanSection
    limits: Mapping[str, Limit]
    payload: float
    own: Trajectory | None = None
    pause: float = 0.0
    loop: Scene | None = None
    before: tuple[Trajectory, ...] = ()
    cycle: tuple[Goals, ...] = ()
    regions: Clearance | None = None
    judged: dict[tuple[int, Any], Any] = field(default_factory=dict, init=False, compare=False, repr=False)

    @property
    def ways(self) -> tuple[Goals, ...]:
        """The goals of each way; a single motion is its only one."""
        return self.cycle or (self,)

    @cached_property
    def trace(self) -> RealArray:
        """Points of the given motion's way, equally spaced by length, (TRACE, 2) [m]."""
        motion = self.given.once
        points = motion.along_path.evaluate(np.linspace(0.0, motion.duration, 20 * TRACE), 0, "left")[0]
        length = lengths(points)
        return interpolated(points, np.linspace(0.0, length[-1], TRACE), length)

    @cached_property
    def path(self) -> Polygon:
        """The given motion's way, there and back: distances from its outline are those from the path."""
        return Polygon.of(np.concatenate([self.trace, self.trace[-2:0:-1]]))

    @cached_property
    def clearance(self) -> Clearance:
        """Where the end effector may go: outside of regions that the scene names, or where its own motion goes."""
        wishes, scene = self.wishes, self.scene
        if self.regions is not None:
            return self.regions
        if wishes.keep_out is not None:
            regions = [Polygon.of(each.outline) for each in wishes.keep_out]
            linked = tuple(region for region, each in zip(regions, wishes.keep_out, strict=True) if each.links)
            return Clearance(tuple(regions), (), True, linked, scene.mechanism)
        # how far the heaviest payload sags at the ends of the motion, in any direction [m]
        heavy, ends = Variation(self.band[1], 1 - wishes.stiffness_band).of(scene), self.trace[[0, -1]]
        pairs = zip(self.ends, ends, strict=True)
        away = [np.hypot(*(static_equilibrium(heavy, joints).position - end)) for joints, end in pairs]
        return clearance_of_trace(self.trace, wishes.corridor, float(max(away)))

    @cached_property
    def given(self) -> MotionPlan:
        """The given motion."""
        return plan(self.scene) if self.own is None else plan_own(self.scene, self.own)

    @cached_property
    def way_around(self) -> RealArray:
        """The shortest way from start to end within the workspace and around the regions on a grid, (N, 2) [m].

        Raises:
            InputError: there is none, or start or end lies in a region.
        """
        mechanism, kinematics, ends = self.scene.mechanism, self.given.kinematics, self.trace[[0, -1]]
        for name, (x, y), distance in zip(("start", "end"), ends, self.clearance.distance(ends), strict=True):
            if distance < -self.wishes.margin:
                raise InputError(
                    f"`plan.keep_out` contains the {name} of the motion, ({x:g}, {y:g}) m, or with `links` one of them there, "
                    f"{1e3 * -distance:.3g} mm within its outline: make the region smaller"
                )
        reach = mechanism.base_half_distance + mechanism.proximal.length + mechanism.distal.length
        side = np.linspace(-reach, reach, GRID)
        points, cell = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2), side[1] - side[0]
        reachable = np.all([each.values > each.required for each in kinematics.margins(points)], axis=0)
        # half a cell: a narrow way isn't taken for blocked
        distance = self.clearance.distance(points)
        free = reachable & (distance > -self.wishes.margin - 0.5 * cell)
        points, tree = points[free], cKDTree(points[free])
        pairs = tree.sparse_distance_matrix(tree, 1.5 * cell, output_type="coo_matrix")
        # ways through thin regions are long
        is_near = distance[free] < cell
        pairs.data *= np.where(is_near[pairs.row] | is_near[pairs.col], FAR, 1.0)
        start, end = np.asarray(tree.query(ends)[1]).tolist()
        length, before = dijkstra(pairs.tocsr(), indices=start, return_predecessors=True)
        if not np.isfinite(length[end]):
            raise InputError(
                f"`plan.keep_out` leaves no way within the workspace from the start to the end, ({x:g}, {y:g}) m: open a gap, or "
                f"make a region smaller"
            )
        places = [end]
        while places[-1] != start:
            places.append(before[places[-1]])
        return np.concatenate([ends[:1], points[places[-2:0:-1]], ends[1:]])

    @cached_property
    def first_motion(self) -> Trajectory:
        """The given motion's joints; where it enters a region, those of a smooth motion around, as long."""
        joints, steps = self.given.once.joints, np.linspace(0.0, 1.0, TRACE)
        if not self.wishes.keep_out or self.clearance.along(self.trace).min() >= -self.wishes.margin:
            return joints
        length = lengths(self.way_around)
        law = steps**3 * (10.0 - 15.0 * steps + 6.0 * steps**2)
        points = uniform_filter1d(interpolated(self.way_around, length[-1] * law, length), SMOOTHED, 0, mode="nearest")
        points[[0, -1]] = self.trace[[0, -1]]
        arms = np.array(self.given.kinematics.elbows(points)) - np.array(bases(self.scene.mechanism))[:, np.newaxis]
        angles = np.unwrap(np.arctan2(arms[..., 1], arms[..., 0]))
        # of the same turn as the given motion's
        angles += 2.0 * np.pi * np.round((self.ends[0] - angles[:, 0]) / (2.0 * np.pi))[:, np.newaxis]
        return spline(joints.duration * steps, angles.T[np.newaxis], coordinates="joints")

    @cached_property
    def ends(self) -> RealArray:
        """Joint angles (2, 2) [rad] at the start and at the end of the given motion."""
        motion = self.given.once
        return np.asarray(motion.joints.evaluate([0.0, motion.duration], 0, "left")[0])

    @property
    def rest(self) -> float:
        """Pauses of a cycle together [s]; 0 for a single motion."""
        return sum(each.pause for each in self.cycle)

    @property
    def drives(self) -> Drives | None:
        """The motors; None if the scene has none."""
        motor, inertia = self.scene.motor, self.scene.effects.motor_inertia
        return None if motor is None else Drives((motor.of_joint(0), motor.of_joint(1)), inertia)

    @cached_property
    def band(self) -> tuple[float, float]:
        """The lightest and the heaviest payload [kg]."""
        return payload_band(self.scene, self.wishes)

    def limit(self, name: str, usual: RealArray) -> RealArray:
        """A limit in its SI unit, from what the given motion needs; `NO_LIMIT` without one."""
        found = self.limits.get(name)
        return np.full_like(usual, NO_LIMIT) if found is None else found.resolved(usual)

    def variations(self, payloads: int) -> tuple[Variation, ...]:
        """Robots within the bands: a number of payloads at the middle and at each corner of the bands of stiffness and damping."""
        return tuple(dict.fromkeys(self._variations(payloads)))

    def cases(self, payloads: int) -> list[tuple[Variation, ...]]:
        """The robots of each way, case by case: the payloads of a case are the same share of the bands of all ways."""
        every = zip(*(each._variations(payloads) for each in self.ways), strict=True)
        return list(zip(*dict.fromkeys(every), strict=True))

    def _variations(self, payloads: int) -> Iterator[Variation]:
        bands = self.wishes.stiffness_band, self.wishes.damping_band
        corners = product(*((1.0, 1 - x, 1 + x) if x else (1.0,) for x in bands))
        yield from (Variation(mass, *each) for each in corners for mass in np.linspace(*self.band, payloads).tolist())


def payload_band(scene: Scene, wishes: PlanSection) -> tuple[float, float]:
    """The lightest and the heaviest payload [kg]."""
    band, mass = wishes.payload_band, scene.payload.mass
    return band if isinstance(band, tuple) else ((1 - band) * mass, (1 + band) * mass)


def goals_of(scene: Scene) -> Goals:
    """The wishes of a scene's section `plan`, or the defaults, in numbers, checked against each other; see `Goals.cycle` for cycles.

    Raises:
        TrajectoryError: the given motion isn't feasible.
        InputError: wishes contradict each other or what the robot can do.
    """
    goals = _goals_of_motion(scene)
    cycle, section = goals.wishes.cycle, goals.scene.trajectory
    if cycle is None:
        return goals
    if goals.loop is not None:
        raise InputError(
            f'scene {scene.name} has controllers, and `plan.cycle` is planned for motors that follow exactly: set `cosimulation.drive = "motion"`'
        )
    if not isinstance(section, TrajectorySection):
        raise InputError(
            f"scene {scene.name} has a motion from a table: `plan.cycle` needs a path, whose height its ways have"
        )
    there = TargetSection(position=tuple(goals.trace[-1].tolist()), payload=scene.payload.mass)
    back = TargetSection(position=goals.scene.start, payload=cycle.return_payload)
    targets, ways = [there, *cycle.targets, back], list[Goals]()
    places = [goals.trace[0], *(np.array(each.position) for each in targets)]
    for k, (target, (start, end)) in enumerate(zip(targets, pairwise(places), strict=True)):
        # paths go to the right, or up; a way to the left is one reversed in time
        left, right = sorted((start, end), key=lambda each: (round(float(each[0]), 9), float(each[1])))
        width = float(np.hypot(*(right - left)))
        if width < SAME_PLACE:
            raise InputError(
                f"`plan.cycle` stays at ({start[0]:g}, {start[1]:g}) m, its place {k + 1}: leave out one of two equal places"
            )
        changes: dict[str, Any] = {"plan.cycle": None, "payload.mass": target.payload, **ONCE}
        if isinstance(goals.wishes.payload_band, tuple) and target.payload != scene.payload.mass:
            changes["plan.payload_band"] = 0.0
        if max(np.hypot(*(places[0] - left)), np.hypot(*(places[1] - right))) > SAME_PLACE:
            # a path of the same height, as fast
            normal = np.array([left[1] - right[1], right[0] - left[0]]) / width
            stretch = (width + 2.0 * section.height) / (section.width + 2.0 * section.height)
            changes |= {
                "trajectory.start": tuple(left.tolist()),
                "trajectory.lift": tuple((normal * np.copysign(1.0, normal @ np.array(section.lift))).tolist()),
                "trajectory.width": width,
                "trajectory.blend.width": min(section.blend.width, 0.5 * width),
                "trajectory.duration": section.duration * stretch**0.5,
            }
        of_way = _goals_of_motion(scene.replace(changes))
        if left is end:
            own = Reversed(of_way.given.once.joints)
            of_way = replace(of_way, own=own, scene=plan_own(of_way.scene, own).scene)
        ways.append(replace(of_way, pause=cycle.pause if target.pause is None else target.pause))
    return replace(goals, cycle=tuple(ways))


def _goals_of_motion(scene: Scene) -> Goals:
    """The goals of a single motion.

    Raises:
        TrajectoryError: the given motion isn't feasible.
        InputError: wishes contradict each other or what the robot can do.
    """
    scene = resolved(scene)
    wishes = scene.plan or PlanSection()
    loop = None
    if scene.cosimulation.drive != "motion":
        if not scene.controller:
            raise InputError(
                f'scene {scene.name} has a torque drive without a controller: add one, or plan with `cosimulation.drive = "motion"`'
            )
        loop, controllers = scene, scene.model_dump(exclude_none=True)["controller"]
        if all(each.kind in ("pd", "pid") for each in scene.controller):
            # they get the torques of the planned motion in addition
            further = {"kind": "feedforward", "robot": "flexible", "sample_time": controllers[0].get("sample_time")}
            loop = scene.replace({"controller": [*controllers, further]})
        scene = scene.replace({"cosimulation.drive": "motion", **dict.fromkeys(LOOP_PARTS, ())})
    if wishes.damping_band and not any(scene_parameters(scene)[name] for name in DAMPING):
        raise InputError(
            f"`plan.damping_band` = {wishes.damping_band:g}, but scene {scene.name} has no damping that could vary: "
            f"leave the band out, or set `effects.damping`"
        )
    asked = {"residual": wishes.residual, "clearance": wishes.margin, **dict(wishes.limits), "time": wishes.duration}
    usual, limits = USUAL if scene.motor is None else OF_MOTORS, dict[str, Limit]()
    for name, wish in asked.items():
        if name in OF_MOTORS and scene.motor is None and wish is not None:
            raise InputError(
                f"`plan.limits.{name}` is relative to what the motors can, and scene {scene.name} has none: add a section `motor`"
            )
        value = wish or usual.get(name, "free")
        if isinstance(value, Ratio):
            limits[name] = Limit(name, value.ratio, "1", is_relative=True, rounding=MET)
        elif value != "free":
            unit = PLAN_FIGURES[name].unit if name in PLAN_FIGURES else unit_of((name,), PlanLimits) or "1"
            limits[name] = Limit(name, value, unit, rounding=MET)
    judged = judged_scene(scene, wishes)
    return Goals(judged, wishes, limits, scene.payload.mass, pause=scene.trajectory.dwell, loop=loop)


def judged_scene(scene: Scene, wishes: PlanSection) -> Scene:
    """The scene as its motions are judged: from rest, since a robot that starts undeformed swings whatever the motion does."""
    dwell = max(scene.trajectory.dwell, wishes.settled_within + LEAST_DWELL)
    changes: dict[str, Any] = {"trajectory.dwell": dwell, "cosimulation.initial": "static"}
    if wishes.limits.reaction is not None:
        changes["effects.reactions"] = True
    # the payload is a parameter of the FMU if the scene has one
    changes["payload.mass"] = scene.payload.mass or payload_band(scene, wishes)[1]
    return scene.replace(changes)


def peak_rates(joints: Trajectory) -> RealArray:
    """Largest speed, acceleration and jerk of a joint (3,) [rad/s ...], among `INSTANTS` and the breakpoints."""
    times = np.union1d(np.linspace(0.0, joints.duration, INSTANTS), joints.breakpoints)
    return np.asarray(np.abs(joints.evaluate(times, 3, "left")[1:]).max(axis=(1, 2)))


def checked_goals(scene: Scene) -> Goals:
    """The wishes of a scene in numbers, checked before anything is simulated; see `check_holding_torque` for ratios.

    Raises:
        TrajectoryError: the given motion isn't feasible.
        InputError: no motion can keep to the wishes; the message names the wish, its value and the remedy.
    """
    goals = goals_of(scene)
    for each in goals.ways:
        if each.wishes.keep_out:
            _ = each.way_around
        check_holding_torque(each)
    _check_duration(goals)
    return goals


def check_holding_torque(goals: Goals, robots: Sequence[Variation] = (), given: RealArray | None = None) -> None:
    """The motors must be able to hold all robots of the bands at the places.

    Args:
        goals: the wishes.
        robots: the robots; none for the lightest and the heaviest.
        given: largest torques of the given motion (R, 2) [N m], which relative limits need; None checks a limit in N m alone.

    Raises:
        InputError: they can't; no motion keeps to the limit then.
    """
    limit, drives, robots = goals.limits.get("torque"), goals.drives, robots or goals.variations(2)
    model = VariantModel([each.robot(goals.scene) for each in robots])
    torques = np.abs([model.rest(joints).torque for joints in goals.ends])
    # what allows so much, less than what is needed at either end by each robot and joint, where, and the remedy
    checks = list[tuple[str, RealArray, RealArray, str, str]]()
    if drives is not None:
        shafts = torques / [each.gear_ratio for each in drives.motors]
        curve = "torque_speed_curve" if any(each.torque_speed_curve for each in drives.motors) else "peak_torque"
        for name, key, most in (
            ("motor_rms_torque", "continuous_torque", np.array([each.continuous_torque for each in drives.motors])),
            ("motor_torque", curve, drives.largest(np.zeros((1, 2)))[0]),
        ):
            if name in goals.limits:
                checks.append((f"`motor.{key}`", most, shafts, "the shaft of motor", "take a stronger motor or gear"))
    if limit is not None and (given is not None or not limit.is_relative):
        unit = "of the given motion's" if limit.is_relative else "N·m"
        most = limit.resolved(torques[0] if given is None else given)
        checks.append((f"`plan.limits.torque` = {limit.limit:g} {unit}", most, torques, "joint", "allow more"))
    for what, most, needed, place, remedy in checks:
        excess = needed / most
        end, k, joint = map(int, np.unravel_index(excess.argmax(), excess.shape))
        more, share = needed[end, k, joint], excess[end, k, joint]
        if share > 1.0 + MET:
            raise InputError(
                f"{what} allows {more / share:.4g} N·m at rest, less than {more:.4g} N·m at {place} {joint + 1}, which hold {robots[k]} "
                f"at the {('start', 'end')[end]} of the motion against gravity: {remedy}, or carry less"
            )


def _check_duration(goals: Goals) -> None:
    """The motors must be able to turn from start to end within the wished time."""
    duration = goals.wishes.duration
    if duration is None:
        return
    turns = np.array([np.abs(np.diff(each.ends, axis=0)).max() for each in goals.ways])
    peaks = np.max([peak_rates(each.given.once.joints) for each in goals.ways], axis=0)
    for k, name in enumerate(RATES):
        value = float(goals.limit(name, peaks[k]))
        # the shortest times from rest to rest: at full speed, by full acceleration, by full jerk
        shortest = (turns / value, 2 * (turns / value) ** 0.5, (32 * turns / value) ** (1 / 3))[k]
        least = float(shortest.sum()) + goals.rest
        if duration < least:
            resting = f" and to rest for {goals.rest:g} s" if goals.rest else ""
            turn = " and ".join(f"{each:.4g}" for each in turns)
            raise InputError(
                f"`plan.duration` = {duration:g} s is below {least:.4g} s, which a joint needs to turn by {turn} rad{resting} with "
                f"`plan.limits.{name}` of {value:.4g} {unit_of((name,), PlanLimits)}: allow more time or more {name}"
            )
