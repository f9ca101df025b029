"""Motions: what `flexfmu.run(scene, trajectory=...)` takes, from files, from other planners, and of your own."""

from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {},
    {
        "trajectories.joint": "JointTrajectory",
        "trajectories.piecewise": "PiecewisePolynomial spline",
        "trajectories.sources": "OwnMotion as_trajectory from_ruckig from_scipy from_toppra",
        "trajectories.table": "read_table write_table",
        "trajectories.trajectory": "TaskTrajectory Trajectory",
    },
)
