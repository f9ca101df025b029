"""The two bases that a scene may choose: which shapes the modes of each elastic family have.

Proximal links are clamped to the motors, distal links are pinned at both ends. With `assumed-modes` these are the paper's
shapes. With `craig-bampton` the first shape of a family whose tip moves is the static one under a force at the tip, and the
others are vibrations with the tip held: the static shape alone carries the whole compliance to the other links, so few
coordinates are enough (Craig and Bampton, AIAA Journal 6, 1968). A hinge passes no moment, so that no static shape belongs
to one; a pinned-pinned link's tip doesn't move across, so that both bases are the same there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from flexfmu.model.beams import (
    Shape,
    clamped_free_bending,
    clamped_pinned_bending,
    fixed_fixed_axial,
    fixed_free_axial,
    pinned_pinned_bending,
    tip_force_axial,
    tip_force_bending,
)
from flexfmu.model.robot import Direction, LinkGroup

Basis = Literal["assumed-modes", "craig-bampton"]
Shapes = Callable[[int], tuple[Shape, ...]]
"""Number of modes → their shapes."""


def family_shapes(basis: Basis, group: LinkGroup, direction: Direction, modes: int) -> tuple[Shape, ...]:
    """The first `modes` shapes of a family."""
    return _SHAPES[basis, direction, group](modes)


def _vibrations(shape: Callable[[int], Shape]) -> Shapes:
    return lambda modes: tuple(shape(k) for k in range(1, modes + 1))


def _static_and(static: Callable[[], Shape], held: Callable[[int], Shape]) -> Shapes:
    return lambda modes: (static(), *_vibrations(held)(modes - 1)) if modes else ()


_ASSUMED_AXIAL, _STATIC_AXIAL = _vibrations(fixed_free_axial), _static_and(tip_force_axial, fixed_fixed_axial)
_SHAPES: dict[tuple[Basis, Direction, LinkGroup], Shapes] = {
    ("assumed-modes", "bending", "proximal"): _vibrations(clamped_free_bending),
    ("assumed-modes", "bending", "distal"): _vibrations(pinned_pinned_bending),
    ("assumed-modes", "axial", "proximal"): _ASSUMED_AXIAL,
    ("assumed-modes", "axial", "distal"): _ASSUMED_AXIAL,
    ("craig-bampton", "bending", "proximal"): _static_and(tip_force_bending, clamped_pinned_bending),
    ("craig-bampton", "bending", "distal"): _vibrations(pinned_pinned_bending),
    ("craig-bampton", "axial", "proximal"): _STATIC_AXIAL,
    ("craig-bampton", "axial", "distal"): _STATIC_AXIAL,
}
