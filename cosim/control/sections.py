"""From sections of the scene file to what stands in the loop: blocks of controllers and imperfections, slaves, shapers.

The file of a controller, a shaper or an imperfection registers the function that builds it from its section::

    @builds(PdSection)
    def _from_section(section: PdSection, context: LoopContext) -> SymbolicBlock: ...

A new kind is such a file and a section in `flexfmu.model.scene`; every module of this room is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import walk_packages
from typing import Any, TypeVar

from flexfmu.cosim import control
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.section import Section
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

S = TypeVar("S", bound=Section)


@dataclass(frozen=True)
class LoopContext:
    """What a builder may need beside its section.

    Attributes:
        scene: the robot as its controllers know it; a payload error changes another one.
        along_path: the planned motion along the path, x, y [m].
        joints: the planned joint trajectory q11, q21 [rad], without shapers.
        period: length of a cycle of a motion that is repeated [s]; None for a motion that is made once.
        name: name of the slave; random numbers follow from it.
        sample_time: [s] of a section that has none of its own.
        before: kind of signal (``position``, ``torque`` ...) → values of both joints before the first sample; empty for
            those of the first sample.
    """

    scene: Scene
    along_path: TaskTrajectory
    joints: Trajectory
    period: float | None
    name: str
    sample_time: float
    before: Callable[[str], Sequence[float]]


_BUILDERS: dict[type[Section], Callable[[Any, LoopContext], Any]] = {}


def builds(
    kind: type[S],
) -> Callable[[Callable[[S, LoopContext], Any]], Callable[[S, LoopContext], Any]]:
    """Register a function that builds what a section asks for.

    Args:
        kind: class of the section.
    """

    def register(builder: Callable[[S, LoopContext], Any]) -> Callable[[S, LoopContext], Any]:
        _BUILDERS[kind] = builder
        return builder

    return register


def build(section: Section, context: LoopContext) -> Any:
    """What a section asks for: a slave, which runs the block if it is one, a `Shaper` or a `PayloadError`.

    Raises:
        InputError: it can't be built, or no module of this room builds such sections.
        TrajectoryError: a shaper doesn't exist for these modes.
    """
    from flexfmu.cosim.control.blocks.slave import BlockSlave

    _register_all()
    if type(section) not in _BUILDERS:
        raise InputError(f"no module of flexfmu.cosim.control builds a {type(section).__name__}: add one with @builds")
    built = _BUILDERS[type(section)](section, context)
    return BlockSlave(built, context.name) if isinstance(built, SymbolicBlock) else built


@cache
def _register_all() -> None:
    """Import every module of this room, which registers its builders."""
    for module in walk_packages(control.__path__, f"{control.__name__}."):
        import_module(module.name)
