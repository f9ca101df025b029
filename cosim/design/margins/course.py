"""Where a loop is linearised: along its motion, with several payloads, and nearest to instability.

Between places the worst values are searched by bisection: the interval goes first whose values could be lowest if they fell as fast as
about it (after S. A. Piyavskii, An algorithm for finding the absolute extremum of a function, USSR Comput. Math. Math. Phys. 12 (1972),
with slopes for the unknown Lipschitz constant).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import numpy as np

from flexfmu.cosim.control.controllers.joints import JOINTS
from flexfmu.cosim.design.margins.linear_loop import LinearLoop
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.controllers import ScheduleSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.section import Section
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import positions_along

FIRST, NARROWEST, MOST = 8, 1.0 / 128.0, 60
"""Intervals of the path with which a search begins, shortest interval that is halved, and largest number of places."""

STEEPER, ENOUGH = 1.5, 0.005
"""Slope that is expected between two places, relative to the largest one about them, and relative error of what is worst."""

SMALLEST, SAME = 1e-3, 1e-4
"""Value below which the error isn't relative, and relative difference of values that are as bad."""

INSTANTS = 2001
"""Instants of the motion, for the time at a place."""

CLOSEST = 1e-4
"""Distance of breakpoints of schedules, as shares of the path, below which they are one."""

Found = TypeVar("Found")


@dataclass(frozen=True)
class Place:
    """A share of the path, 0 to 1, and the robot's payload [kg]."""

    s: float
    payload: float


class PathLoop:
    """A loop along the path of its motion.

    Args:
        wired: the loop.
        motion: its planned motion.
        identify: whether Python functions and FMUs are called to find their linear blocks.
    """

    def __init__(self, wired: WiredLoop, motion: MotionPlan, identify: bool = True) -> None:
        self._wired, self._once, self._identify = wired, motion.once, identify
        self._ways = (1.0, -1.0) if motion.repetition is not None else (1.0,)
        self._times = np.linspace(0.0, self._once.duration, INSTANTS)
        positions = self._once.task.evaluate(self._times, 0)[0]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
        self._shares = arc / arc[-1] if arc[-1] > 0.0 else np.linspace(0.0, 1.0, INSTANTS)

    @property
    def payload(self) -> float:
        """The robot's own payload [kg]."""
        return self._wired.payload

    def position(self, s: float) -> tuple[float, float]:
        """The end effector [m] at a share of the path."""
        x, y = positions_along(self._once.along_path, s)[0].tolist()
        return x, y

    def joints(self, s: float) -> tuple[float, float]:
        """The joint angles [rad] there."""
        first, second = motor_angles(self._once.scene.mechanism, self.position(s))
        return float(first), float(second)

    def breakpoints(self, scene: Scene) -> list[float]:
        """Shares of the path at which a gain schedule of the scene has a breakpoint or its signal turns, if the motion determines it.

        Between them gains rise or fall all the way; a search that doesn't know these places could miss a narrow peak.
        """
        position, velocity = self._once.joints.evaluate(self._times, 1)
        way = self._once.task.evaluate(self._times, 0)[0]
        signals = {f"end_effector.position.{axis}": way[:, k] for k, axis in enumerate("xy")}
        for k, joint in enumerate(JOINTS):
            for name, values in (("position", position[:, k]), ("velocity", velocity[:, k])):
                signals |= {f"{joint}.{name}": values, f"{joint}.reference.{name}": values}
        found: set[float] = set()
        for schedule in _schedules(scene.controller):
            if (signal := signals.get(schedule.over)) is None:
                continue
            rises = np.diff(signal)
            found |= set(self._shares[1:-1][rises[:-1] * rises[1:] < 0.0].tolist())
            for value, sign in product(schedule.at, self._ways if "velocity" in schedule.over else (1.0,)):
                beyond = sign * signal - value
                for k in np.flatnonzero(beyond[:-1] * beyond[1:] <= 0.0).tolist():
                    rise = beyond[k + 1] - beyond[k]
                    part = -beyond[k] / rise if rise else 0.0
                    found.add(float(self._shares[k] + part * (self._shares[k + 1] - self._shares[k])))
        apart: list[float] = []
        for share in sorted(found):
            if not apart or share - apart[-1] > CLOSEST:
                apart.append(share)
        return apart

    def loops(self, place: Place) -> Iterator[tuple[LinearLoop, tuple[str, ...]]]:
        """Yield the linear loop at a place, and the names of its channels, with the gains of the way there, then of the way back."""
        time = float(np.interp(place.s, self._shares, self._times))
        velocity = self._once.joints.evaluate(time, 1, "left")[1, 0] if 0.0 < place.s < 1.0 else np.zeros(2)
        payload = None if place.payload == self.payload else place.payload
        first = None
        for way in self._ways:
            loop, names = self._wired.at(self.position(place.s), self._identify, way * velocity, payload)
            if first is None or any(
                not one.equals(other) for one, other in zip(loop.blocks, first.blocks, strict=True)
            ):
                yield loop, names
            first = first or loop


def _schedules(sections: Iterable[Section]) -> Iterator[ScheduleSection]:
    """The schedules of controllers and of their loops."""
    for section in sections:
        for name in type(section).model_fields:
            value = getattr(section, name)
            if isinstance(value, ScheduleSection):
                yield value
            elif isinstance(value, Section):
                yield from _schedules((value,))


def worst_places(
    found_at: Callable[[Place], Found],
    measures: Callable[[Found], Sequence[float]],
    shares: Sequence[float],
    payloads: Sequence[float],
    progress: Callable[[float], None] = lambda fraction: None,
) -> dict[Place, Found]:
    """What was found at places that were searched, with those where each measure is least.

    Args:
        found_at: what there is at a place.
        measures: its measures, smaller for what is worse, about 1 or smaller where it matters.
        shares: shares of the path at which the search begins, beside those of equal intervals; a single one is the only one.
        payloads: the robot's own one [kg], and the ends of a band, if there is one.
        progress: called with the finished fraction, 0 to 1.
    """
    known: dict[Place, Found] = {}
    nodes = [*shares] if len(shares) == 1 else sorted({*shares, *np.linspace(0.0, 1.0, FIRST + 1).tolist()})
    expected = 2 * len(nodes) * len(set(payloads))

    def values(place: Place) -> RealArray:
        if place not in known:
            known[place] = found_at(place)
            progress(min(len(known) / expected, 0.99))
        return np.array(measures(known[place]))

    def along(payload: float) -> None:
        _search(lambda s: values(Place(s, payload)), nodes)

    for payload in dict.fromkeys(payloads):
        along(payload)
    if len(masses := sorted(set(payloads))) > 1:
        # where it is worst, other payloads; if one of them is worse, along the path with it
        for place in least_places(known, measures):
            _search(lambda mass, s=place.s: values(Place(s, mass)), masses)  # type: ignore[misc]
        for payload in {place.payload for place in least_places(known, measures)}.difference(payloads):
            along(payload)
    progress(1.0)
    return known


def least_places(known: Mapping[Place, Found], measures: Callable[[Found], Sequence[float]]) -> list[Place]:
    """Few places at which each measure is least, or nearly."""
    chosen: list[Place] = []
    table = {place: measures(found) for place, found in known.items()}
    for k in range(len(next(iter(table.values())))):
        least = min(table, key=lambda place, k=k: table[place][k])  # type: ignore[misc]
        bound = table[least][k] + SAME * max(abs(table[least][k]), SMALLEST)
        if not any(table[place][k] <= bound for place in chosen):
            chosen.append(least)
    return chosen


def _search(values: Callable[[float], RealArray], nodes: Sequence[float]) -> None:
    """Halve intervals between nodes, until none could hold a value that is noticeably less."""
    x, v = [*nodes], [values(each) for each in nodes]
    span = x[-1] - x[0]
    while 1 < len(x) < MOST:
        table, widths = np.array(v), np.diff(x)[:, np.newaxis]
        slopes = np.pad(np.abs(np.diff(table, axis=0)) / widths, ((1, 1), (0, 0)))
        steepest = np.max([slopes[:-2], slopes[1:-1], slopes[2:]], axis=0)
        lowest = 0.5 * (table[:-1] + table[1:] - STEEPER * steepest * widths)
        least = table.min(axis=0)
        gains = ((least - lowest) / (ENOUGH * np.maximum(np.abs(least), SMALLEST))).max(axis=1)
        gains[widths[:, 0] <= NARROWEST * span] = 0.0
        k = int(gains.argmax())
        if gains[k] <= 1.0:
            return
        x.insert(k + 1, 0.5 * (x[k] + x[k + 1]))
        v.insert(k + 1, values(x[k + 1]))
