"""Mode shapes of the links that a scene chooses, without CasADi.

A scene chooses between two bases. Proximal links are clamped to the motors, distal links are pinned at both ends. With
`assumed-modes` the shapes are the paper's. With `craig-bampton` the first shape of a family is the static deflection
under a tip force, and the others are fixed-interface modes, whose tip is fixed. The static shape alone contains the
whole compliance at the tip, so few coordinates suffice (Craig and Bampton, AIAA Journal 6, 1968). Hinges transmit no
moment, so there is no static shape for one. The tip of a pinned-pinned link has no transverse displacement, so both
bases are the same there.
"""

from __future__ import annotations

from collections.abc import Callable

from flexfmu.model.beams import (
    Basis,
    Direction,
    LinkGroup,
    Shape,
    clamped_free_bending,
    clamped_pinned_bending,
    fixed_fixed_axial,
    fixed_free_axial,
    pinned_pinned_bending,
    tip_force_axial,
    tip_force_bending,
)
from flexfmu.model.scene.schema import Scene
from flexfmu.model.timoshenko import slenderness, timoshenko_shapes

FAMILIES: tuple[tuple[LinkGroup, Direction], ...] = (
    ("proximal", "axial"),
    ("proximal", "bending"),
    ("distal", "axial"),
    ("distal", "bending"),
)
"""Elastic families: link group and direction of deflection."""

Shapes = Callable[[int], tuple[Shape, ...]]
"""Number of modes → shapes."""


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


def scene_shapes(scene: Scene) -> dict[tuple[LinkGroup, Direction], tuple[Shape, ...]]:
    """The shapes of each elastic family that the scene has, in the order of `FAMILIES`; those of its beam theory."""
    chosen, found = scene.effects, dict[tuple[LinkGroup, Direction], tuple[Shape, ...]]()
    for group, direction in FAMILIES:
        modes: int = getattr(chosen, f"{group}_{direction}")
        if not modes:
            continue
        # shear matters in bending alone
        if direction == "bending" and chosen.beam == "timoshenko":
            found[group, direction] = timoshenko_shapes(chosen.basis, group, modes, slenderness(scene.mechanism, group))
        else:
            found[group, direction] = family_shapes(chosen.basis, group, direction, modes)
    return found
