from flexfmu.trajectories.joint import JointTrajectory as JointTrajectory
from flexfmu.trajectories.piecewise import PiecewisePolynomial as PiecewisePolynomial
from flexfmu.trajectories.piecewise import spline as spline
from flexfmu.trajectories.sources import OwnMotion as OwnMotion
from flexfmu.trajectories.sources import as_trajectory as as_trajectory
from flexfmu.trajectories.sources import from_ruckig as from_ruckig
from flexfmu.trajectories.sources import from_scipy as from_scipy
from flexfmu.trajectories.sources import from_toppra as from_toppra
from flexfmu.trajectories.table import read_table as read_table
from flexfmu.trajectories.table import write_table as write_table
from flexfmu.trajectories.trajectory import TaskTrajectory as TaskTrajectory
from flexfmu.trajectories.trajectory import Trajectory as Trajectory

__all__ = ['JointTrajectory', 'OwnMotion', 'PiecewisePolynomial', 'TaskTrajectory', 'Trajectory', 'as_trajectory', 'from_ruckig', 'from_scipy', 'from_toppra', 'read_table', 'spline', 'write_table']

