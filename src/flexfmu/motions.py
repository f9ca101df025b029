"""Motions: what `flexfmu.run(scene, trajectory=...)` takes, from files, from other planners, and of your own."""

from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {},
    {
        "trajectories.joint": "JointTrajectory",
        "trajectories.own": "OwnMotion as_trajectory",
        "trajectories.piecewise": "PiecewisePolynomial spline",
        "trajectories.sources": "from_ruckig from_scipy from_toppra",
        "trajectories.table": "write_table",
        "trajectories.table_file": "read_table",
        "trajectories.trajectory": "TaskTrajectory Trajectory",
    },
)
