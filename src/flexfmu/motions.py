"""Motions: what `flexfmu.run(scene, trajectory=...)` takes, from files, from other planners, and of your own."""

from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.own import OwnMotion, as_trajectory
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
from flexfmu.trajectories.sources import from_ruckig, from_scipy, from_toppra
from flexfmu.trajectories.table import write_table
from flexfmu.trajectories.table_file import read_table
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

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
