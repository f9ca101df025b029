"""What quick runs say of a motion: what is minimised, and how close the motion comes to each limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, log

import numpy as np

from flexfmu.cosim.design.plans.quick_runs import QuickRun
from flexfmu.trajectories.jets import RealArray

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
        others: name → largest value, of `FIGURES`.
        distance: signed distances (N,) of positions (N, 2) [m] from the keep-out region, negative inside; None without one.
        margin: by how much the end effector may come nearer [m].
        passage: how far a way through positions (N, 2) [m] would have to move to go around what it passes through [m].
    """

    minimise: str
    residual: float
    settled_within: float
    torque: RealArray
    others: Mapping[str, float] = field(default_factory=dict)
    distance: Callable[[RealArray], RealArray] | None = None
    margin: float = 0.0
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
        """``time`` [s], ``residual`` [m], ``torque`` and ``rms_torque`` [N.m], ``energy`` without what motors take back
        [J], ``power`` [W], and ``speed``, ``acceleration``, ``jerk`` of the joints [rad/s ...]."""
        run, step = self.run, self.run.time[1] - self.run.time[0]
        moving = run.torque[:, : run.moving]
        return {
            "time": run.motion.duration,
            "residual": float(run.residuals(self.bounds.settled_within).max()),
            "torque": float(run.peak_torques.max()),
            "energy": float(np.maximum(run.powers, 0.0).sum(axis=(1, 2)).max() * step),
            "rms_torque": float(np.sqrt((moving**2).mean(axis=1)).max()),
            "power": float(np.abs(run.powers).max()),
            **dict(zip(("speed", "acceleration", "jerk"), run.motion.peaks.tolist(), strict=True)),
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
            if limit < inf:
                rates = self._rates.get(name)
                found[name] = np.array([self.values[name] / limit]) if rates is None else _both(rates.ravel() / limit)
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
        for name in ("rows", "minimised", "_rates"):
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
