"""Coordinates of each element, and positions of the nodes on the rigid robot.

A link is a chain of elements; at a hinge, the nodes of two links share their position, but not their angle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.beams import LinkGroup
from flexfmu.model.kinematics import RigidForwardKinematics
from flexfmu.model.scene.assembly import bases, elbow
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.jets import Jet, RealArray

Index = NDArray[np.intp]

BASES = ((0, 1), (3, 4))
"""Indices of the x and y coordinates of both bases."""

MOTORS = (2, 5)
"""Indices of the motor angles: the angles at the roots of the proximal links."""

HELD = 6
"""Number of prescribed coordinates (bases and motors); they come first."""


@dataclass(frozen=True)
class Mesh:
    """Indices of all coordinates.

    Attributes:
        size: number of coordinates.
        nodes: link name → indices of x, y, theta of its nodes (elements + 1, 3).
        end: indices of the end effector's x and y.
    """

    size: int
    nodes: dict[str, Index]
    end: tuple[int, int]

    def elements(self, link: str) -> Index:
        """Indices of the coordinates of each element of a link (elements, 6)."""
        nodes = self.nodes[link]
        return np.hstack([nodes[:-1], nodes[1:]])


def five_bar_mesh(elements: int) -> Mesh:
    """The mesh with `elements` elements per link; hinged nodes share their positions."""
    # bases and motors come first, then the end effector, then the nodes of each link
    free = iter(range(HELD, HELD + 100 * (elements + 1)))
    end = (next(free), next(free))
    nodes = {}
    for leg in (1, 2):
        root = [*BASES[leg - 1], MOTORS[leg - 1]]
        proximal = [root, *([next(free) for _ in range(3)] for _ in range(elements))]
        elbow = proximal[-1][:2]
        between = [[next(free) for _ in range(3)] for _ in range(elements - 1)]
        distal = [[*elbow, next(free)], *between, [*end, next(free)]]
        nodes[f"link{leg}1"], nodes[f"link{leg}2"] = np.array(proximal), np.array(distal)
    return Mesh(next(free), nodes, end)


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
    """Positions (elements + 1, 2) [m] of equally spaced nodes on a straight line."""
    fraction = np.linspace(0.0, 1.0, elements + 1)[:, None]
    return np.asarray(np.array(root) * (1.0 - fraction) + np.array(tip) * fraction)
