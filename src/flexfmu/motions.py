"""Motions: what `flexfmu.run(scene, trajectory=...)` takes, from files, from other planners, and of your own."""

from flexfmu.trajectories import (
    JointTrajectory,
    PiecewisePolynomial,
    TaskTrajectory,
    Trajectory,
    as_trajectory,
    from_ruckig,
    from_scipy,
    from_toppra,
    read_table,
    spline,
    write_table,
)
from flexfmu.trajectories.own import OwnMotion

__all__ = [
    "JointTrajectory",
    "OwnMotion",
    "PiecewisePolynomial",
    "TaskTrajectory",
    "Trajectory",
    "as_trajectory",
    "from_ruckig",
    "from_scipy",
    "from_toppra",
    "read_table",
    "spline",
    "write_table",
]
