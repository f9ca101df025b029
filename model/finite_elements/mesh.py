"""Which coordinates belong to which element: chains of elements, joined where hinges share a node's position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]

BASES = ((0, 1), (3, 4))
"""Positions of both base joints among the coordinates."""

MOTORS = (2, 5)
"""Angles at the roots of the proximal links, where the motors turn them."""

HELD = 6
"""Number of coordinates that bases and motors prescribe, which come first."""


@dataclass(frozen=True)
class Mesh:
    """Global numbers of all coordinates.

    Attributes:
        size: number of coordinates.
        nodes: link name → (elements + 1, 3) numbers of x, y, theta of its nodes.
        end: numbers of the end effector's x and y.
    """

    size: int
    nodes: dict[str, Index]
    end: tuple[int, int]

    def elements(self, link: str) -> Index:
        """(elements, 6) coordinates of each element of a link."""
        nodes = self.nodes[link]
        return np.hstack([nodes[:-1], nodes[1:]])


def five_bar_mesh(elements: int) -> Mesh:
    """So many elements a link; proximal tips and distal roots share positions, so do both distal tips."""
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
