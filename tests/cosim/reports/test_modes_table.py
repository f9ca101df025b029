"""The table of frequencies along the path: where its poses are."""

from __future__ import annotations

import numpy as np

from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports.modes_table import modes_along_path
from flexfmu.model.scene.file import load_scene


def test_angles_do_not_jump_where_a_leg_points_left() -> None:
    """Beside the base the path crosses the direction in which arc tangents jump by a turn; the motors do not."""
    beside = load_scene("barnard2012-6kg").replace(
        {
            "trajectory.start": [-0.35, 0.02],
            "trajectory.height": 0.04,
            "trajectory.width": 0.08,
            "trajectory.blend": {"kind": "lame", "height": 0.02, "width": 0.02},
            "effects.proximal_bending": 0,
            "effects.distal_axial": 0,
            "effects.damping": "none",
        }
    )
    poses = modes_along_path(plan(beside), 21)
    assert min(pose.y for pose in poses) < 0.0 < max(pose.y for pose in poses)
    angles = np.array([(pose.q11, pose.q21) for pose in poses])
    assert np.abs(np.diff(angles, axis=0)).max() < 0.1
    assert all(pose.frequencies == () for pose in poses)
