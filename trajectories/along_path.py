"""Places along the path of any motion, by arc length."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import sampled_positions
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory


def positions_along(motion: Trajectory, fractions: ArrayLike) -> RealArray:
    """Return positions (N, 2) [m] at fractions (N,) of the path's length, from start to end.

    They are exact for a `TaskTrajectory`. For other motions the path is that of thousands of samples: a place is known to
    about a millionth of the path's length.

    Args:
        motion: motion of the end effector, x and y [m].
        fractions: 0 to 1.
    """
    share = np.atleast_1d(np.asarray(fractions, dtype=float))
    if isinstance(motion, TaskTrajectory):
        return np.stack([jet.value for jet in motion.path.jets(share * motion.path.length, order=0)], axis=-1)
    _, positions = sampled_positions(motion)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    return np.stack([np.interp(share * arc[-1], arc, coordinate) for coordinate in positions.T], axis=-1)
