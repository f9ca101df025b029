"""Builds the slaves and shapers of a loop from sections of the scene file.

A section describes a part of the loop; the function that makes its block from it stands in the part's file::

    @builds(PdSection)
    def pd(s: PdSection, context: LoopContext) -> SymbolicBlock: ...

or, where one expression says it, ``builds(LeadLagSection)(lambda section, context: ...)``. A new kind needs such a
function and a section in `flexfmu.model.scene`, which checks its values; every module of this package is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from math import isfinite
from pkgutil import walk_packages
from typing import Any, TypeVar

from flexfmu.cosim import control
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.section import Section
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.trajectory import Trajectory, positions_along

S = TypeVar("S", bound=Section)


@dataclass(frozen=True)
class LoopContext:
    """Scene, motion and names that a builder may need beside its section.

    Attributes:
        scene: the robot that the controllers assume, without payload error.
        along_path: the planned motion before shaping, x, y [m].
        joints: the planned joint trajectory q11, q21 [rad], without shapers.
        shaped: the same with shapers and cycles, as the references run.
        period: of a repeated motion [s]; None for a motion that isn't repeated.
        name: name of the slave, which also selects its random numbers.
        sample_time: for sections without one [s].
        before: kind of signal (``position``, ``torque`` ...) → values of both joints before the first sample; empty
            where the value of the first sample is taken.
        is_about_rest: whether the loop is for small motions about standstill.
    """

    scene: Scene
    along_path: Trajectory
    joints: Trajectory
    shaped: Trajectory
    period: float | None
    name: str
    sample_time: float
    before: Callable[[str], Sequence[float]]
    is_about_rest: bool = False

    def position(self, pose: str) -> tuple[float, float]:
        """Position of the end effector [m] at the ``start``, ``middle`` or ``end`` of its path."""
        x, y = positions_along(self.along_path, {"start": 0.0, "middle": 0.5, "end": 1.0}[pose])[0].tolist()
        return x, y


_BUILDERS: dict[type[Section], Callable[[Any, LoopContext], Any]] = {}


def builds(kind: type[S]) -> Callable[[Callable[[S, LoopContext], Any]], Callable[[S, LoopContext], Any]]:
    """Register the function that builds sections of a kind.

    Args:
        kind: class of the section.
    """

    def register(builder: Callable[[S, LoopContext], Any]) -> Callable[[S, LoopContext], Any]:
        _BUILDERS[kind] = builder
        return builder

    return register


def block_of(section: Section, context: LoopContext) -> Any:
    """What the builder of a section makes: a block, several of them, a slave, or a `Shaper`; errors as for `build`."""
    _register_all()
    return _BUILDERS[type(section)](section, context)


def build(section: Section, context: LoopContext) -> Any:
    """Build a section: a slave (a block becomes a `BlockSlave`), several of them, or a `Shaper`.

    Several blocks are called after the section, an underscore between: ``cascade_position``.

    Raises:
        InputError: it can't be built.
        TrajectoryError: a shaper doesn't exist for these modes.
    """
    from flexfmu.cosim.control.blocks.slave import BlockSlave

    built = block_of(section, context)
    if isinstance(built, tuple):
        return tuple(BlockSlave(each, f"{context.name}_{each.name}") for each in built)
    return BlockSlave(built, context.name) if isinstance(built, SymbolicBlock) else built


@cache
def _register_all() -> None:
    """Import every module of this package, which registers its builders."""
    for module in walk_packages(control.__path__, f"{control.__name__}."):
        import_module(module.name)


def with_payload_error(scene: Scene, relative: float) -> Scene:
    """Return the scene with (1 + relative) times its payload.

    Build the plant from this scene, controllers and shapers from the original one, or the other way round.

    Args:
        scene: the scene.
        relative: relative error of the mass, for example -0.3 for 30 % less.

    Raises:
        InputError: the error isn't finite or is below -1, or the scene has no payload.
    """
    mass = scene.payload.mass
    if not (isfinite(relative) and relative >= -1.0):
        raise InputError(f"the relative payload error must be finite and at least -1 (no payload), got {relative}")
    if mass == 0.0 and relative:
        raise InputError(
            f"scene {scene.name} has no payload, so {relative:+.0%} of it changes nothing; "
            "give the mass itself: scene.replace({'payload.mass': 0.1})"
        )
    return scene.replace({"payload.mass": mass * (1.0 + relative)})
