"""Where the links of the rigid robot lie, between which nodes are placed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexfmu.model.kinematics import RigidForwardKinematics
from flexfmu.model.robot import LinkGroup
from flexfmu.model.scene.assembly import Point, bases, elbow
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.trajectories.jets import Jet, RealArray

LINKS: dict[LinkGroup, tuple[str, str]] = {"proximal": ("link11", "link21"), "distal": ("link12", "link22")}


def rigid_links(mechanism: Mechanism, joints: RealArray) -> Iterator[tuple[LinkGroup, str, Point, Point]]:
    """Group, name, root and tip [m] of all links of the rigid robot, with the motors at the angles (2,) [rad]."""
    fore = RigidForwardKinematics(mechanism).end_effector(*(Jet.constant([q], 0) for q in joints))
    end = float(fore[0].coefficients[0, 0]), float(fore[1].coefficients[0, 0])
    for leg, (base, q) in enumerate(zip(bases(mechanism), joints, strict=True)):
        middle = elbow(base, float(q), mechanism.proximal.length)
        yield "proximal", LINKS["proximal"][leg], base, middle
        yield "distal", LINKS["distal"][leg], middle, end


def straight(root: Point, tip: Point, elements: int) -> RealArray:
    """Positions (elements + 1, 2) [m] of nodes at equal distances."""
    fraction = np.linspace(0.0, 1.0, elements + 1)[:, None]
    return np.asarray(np.array(root) * (1.0 - fraction) + np.array(tip) * fraction)
