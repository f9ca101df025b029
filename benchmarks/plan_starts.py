"""Whether optimal control's fastest motion depends on where it begins: its share of the given time from drawn first motions, for 7 payloads.

python benchmarks/plan_starts.py [--starts N] [--limit NAME=VALUE ...] [SCENE ...]

First motions are a half to all as long as the given one, along its path or beside it by smooth waves.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.cli.design import with_wishes
from flexfmu.cosim.design.plans.assessment import JUDGED, Judge
from flexfmu.cosim.design.plans.goals import checked_goals
from flexfmu.cosim.design.plans.optimal import FEW, limited, robots_of
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.reference_design.joint_spline import REST, JointSpline
from flexfmu.model.reference_design.optimal_control import LOOSE, optimal_motion
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

WAVES, SIZE = 3, 0.08
"""Waves of a first motion beside the path, and the standard deviation of the first one relative to the swing of the joints."""

MET = 5e-3
"""Violation of limits up to which a motion counts."""


def first_motions(given: JointSpline, number: int, seed: int) -> Iterator[JointSpline]:
    """The given motion faster, then drawn ones."""
    random, swing = np.random.default_rng(seed), np.ptp(given.coefficients, axis=0)
    along = np.linspace(0.0, 1.0, len(given.coefficients))[:, np.newaxis]
    for k in range(number):
        sizes = SIZE * random.standard_normal((WAVES, 2)) if k else np.zeros((WAVES, 2))
        waves = sum(size * np.sin(np.pi * m * along) / m for m, size in enumerate(sizes, start=1))
        waves[:REST], waves[-REST:] = 0.0, 0.0
        coefficients = given.coefficients + swing * waves
        yield replace(given, coefficients=coefficients, duration=given.duration * random.uniform(0.5, 1.0))


@one_blas_thread()
def shares(scene: Scene, number: int, seed: int) -> list[float]:
    """Shares of the given time that motions within all limits take."""
    goals = checked_goals(scene)
    judge, variations = Judge(goals, JUDGED), goals.variations(FEW)
    problem, found = limited(goals, judge.given, [robots_of(scene, variations)]), list[float]()
    given = problem.ways[0].start
    assert isinstance(given, JointSpline)
    for start in first_motions(given, number, seed):
        try:
            *_, ((motion,), violations) = optimal_motion(problem.begun([start], loose=LOOSE), range(len(variations)))
        except (EquilibriumError, TrajectoryError):
            continue
        if max(violations.values()) < MET:
            found.append(motion.duration / judge.given.time)
    return found


def main() -> None:
    """Plan and print."""
    parser = argparse.ArgumentParser(description="Fastest motions from drawn first ones.")
    parser.add_argument("scenes", nargs="*", default=["barnard2012-6kg", "barnard2012-0.1kg"])
    parser.add_argument("--starts", type=int, default=12, help="number of first motions")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", action="append", default=[], help="limits as of flexfmu plan")
    options = parser.parse_args()
    for name in options.scenes:
        scene = with_wishes(load_scene(name), {}, options.limit)
        found = sorted(shares(scene, options.starts, options.seed))
        listed = ", ".join(f"{each:.4f}" for each in found)
        print(f"{scene.name}: {len(found)} of {options.starts} starts end within all limits, at {listed}", flush=True)


if __name__ == "__main__":
    main()
