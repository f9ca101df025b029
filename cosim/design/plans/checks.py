"""Wishes that contradict each other, or what the robot can do: told before long work."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.design.plans.assessment import Assessment
from flexfmu.cosim.design.plans.goals import MET, RATES, UNITS, Goals, goals_of, peak_rates
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

GRID = 160
"""Points along each side of the grid on which a way around the regions is looked for."""

INSTANTS = 2001
"""Instants of the given motion at which its references are examined."""


def checked_goals(scene: Scene) -> Goals:
    """The wishes of a scene in numbers, checked before anything is simulated; see `check_holding_torque` for ratios.

    Raises:
        TrajectoryError: the given motion isn't feasible.
        InputError: no motion can keep to the wishes; the message names the wish, its value and the remedy.
    """
    goals = goals_of(scene)
    _check_ends(goals)
    _check_way(goals)
    check_holding_torque(goals)
    _check_duration(goals)
    return goals


def _check_ends(goals: Goals) -> None:
    """Start and end may not lie where the end effector must not be."""
    for name, point in (("start", goals.trace[0]), ("end", goals.trace[-1])):
        distance = float(goals.clearance.distance(point[None])[0])
        if distance < -goals.wishes.margin:
            raise InputError(
                f"`plan.keep_out` contains the {name} of the motion, ({point[0]:g}, {point[1]:g}) m, {1e3 * -distance:.3g} mm "
                f"within its outline: make the region smaller"
            )


def _check_way(goals: Goals) -> None:
    """There must be a way from start to end within the workspace, around the user's regions."""
    if not goals.wishes.keep_out:
        return
    mechanism = goals.scene.mechanism
    reach = mechanism.base_half_distance + mechanism.proximal.length + mechanism.distal.length
    side = np.linspace(-reach, reach, GRID)
    points = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    flat = points.reshape(-1, 2)
    kinematics = goals.given.kinematics
    reachable = np.all([each.values > each.required for each in kinematics.margins(flat)], axis=0)
    # half a cell: a narrow way isn't taken for blocked
    free = reachable & (goals.clearance.distance(flat) > -goals.wishes.margin - 0.5 * (side[1] - side[0]))
    start, end = (
        int(np.argmin(np.hypot(*(flat - point).T) + np.where(free, 0.0, 1e3))) for point in goals.trace[[0, -1]]
    )
    if not _connected(free.reshape(GRID, GRID), divmod(start, GRID), divmod(end, GRID)):
        x, y = goals.trace[-1]
        raise InputError(
            f"`plan.keep_out` leaves no way within the workspace from the start to the end, ({x:g}, {y:g}) m: open a gap, or "
            f"make a region smaller"
        )


def _connected(free: NDArray[np.bool_], start: tuple[int, int], end: tuple[int, int]) -> bool:
    """Whether free cells lead from one to another."""
    seen = np.zeros_like(free)
    seen[start] = True
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if cell == end:
            return True
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                other = cell[0] + i, cell[1] + j
                if min(other) >= 0 and max(other) < len(free) and free[other] and not seen[other]:
                    seen[other] = True
                    queue.append(other)
    return False


def check_holding_torque(goals: Goals, given: Assessment | None = None) -> None:
    """The motors must be able to hold all robots of the bands at the places.

    Args:
        goals: the wishes.
        given: the given motion, which a limit relative to its torques needs; None checks a limit in N.m alone.

    Raises:
        InputError: they can't; no motion keeps to the limit then.
    """
    limit = goals.limits.get("torque")
    if limit is None or (limit.is_relative and given is None):
        return
    robots = goals.variations(2) if given is None else [each.variation for each in given.peaks]
    motion = goals.given.once
    for name, instant in (("start", 0.0), ("end", motion.duration)):
        joints = motion.joints.evaluate([instant], 0, "left")[0, 0]
        for k, robot in enumerate(robots):
            torques = np.abs(static_equilibrium(robot.of(goals.scene), joints).torque)
            for joint, torque in enumerate(torques.tolist()):
                most, wish = limit.limit, f"{limit.limit:g} N·m"
                if given is not None and limit.is_relative:
                    most = limit.limit * given.peaks[k].torque[joint]
                    wish = f"{limit.limit:g} of the given motion's, {most:.4g} N·m of joint {joint + 1},"
                if torque > most * (1.0 + MET):
                    raise InputError(
                        f"`plan.limits.torque` = {wish} is below {torque:.4g} N·m, which hold {robot} at the {name} of the "
                        f"motion against gravity: allow more, or carry less"
                    )


def _check_duration(goals: Goals) -> None:
    """The motors must be able to turn from start to end within the wished time."""
    duration = goals.wishes.duration
    if duration is None:
        return
    motion = goals.given.once
    ends = motion.joints.evaluate([0.0, motion.duration], 0, "left")[0]
    turn = float(np.abs(ends[1] - ends[0]).max())
    peaks = peak_rates(motion.joints, INSTANTS)
    for k, name in enumerate(RATES):
        if name not in goals.limits:
            continue
        value = float(goals.limits[name].resolved(peaks[k]))
        # the shortest time from rest to rest: at full speed, by full acceleration, by full jerk
        least = (turn / value, 2 * (turn / value) ** 0.5, (32 * turn / value) ** (1 / 3))[k]
        if duration < least:
            raise InputError(
                f"`plan.duration` = {duration:g} s is below {least:.4g} s, which a joint needs to turn by {turn:.4g} rad with "
                f"`plan.limits.{name}` of {value:.4g} {UNITS[name]}: allow more time or more {name}"
            )
