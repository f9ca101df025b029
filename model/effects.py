"""What an effect may contribute to the model: coordinates, energies, dissipation and outputs.

The sum of all effects is the model. An effect that a scene leaves out isn't constructed, so it leaves no state, no term and no
line in the generated C. A new effect is a subclass of `Effect` in a file of its own; its key and the line that registers it are in
`flexfmu.model.scene.effects`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import Family, LinkGroup, Robot
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import EffectNote
from flexfmu.trajectories.jets import RealArray


@dataclass(frozen=True)
class Stiction:
    """Dry friction that can hold a motor.

    Attributes:
        torque: the friction torque that opposes the slip at a motor rate [rad/s], in N m.
        breakaway: derived value: the largest torque that holds the motor.
        direction: switch: the direction of slip; 0 stands for the sign of the rate.
    """

    torque: Callable[[casadi.SX], casadi.SX]
    breakaway: casadi.SX
    direction: casadi.SX


@dataclass(frozen=True)
class Output:
    """A scalar that follows from the elastic coordinates linearly: gain' q.

    Attributes:
        name, unit, description: as FMI shows it.
        coordinates: the elastic coordinates (K, 1) of one link.
        gain: shape (K, 1), of numbers or derived values.
    """

    name: str
    unit: str
    description: str
    coordinates: casadi.SX
    gain: casadi.SX


@dataclass(frozen=True)
class EffectContext:
    """What effects are made from.

    Attributes:
        scene: the scene, whose keys choose the effects.
        registry: where an effect registers its parameters and the values that follow from them.
        links: mass, sizes and stiffness of the link groups, in symbols.
    """

    scene: Scene
    registry: ParameterRegistry
    links: Mapping[LinkGroup, LinkProperties]


class Effect(ABC):
    """What an effect may contribute; each hook's default is nothing.

    Attributes:
        note: title, sentence and formula for the documentation, and what the effect contributes: of the class, or of an
            instance where they depend on the scene's values.
    """

    note: EffectNote

    @classmethod
    @abstractmethod
    def from_scene(cls, context: EffectContext) -> Iterable[Effect]:
        """The effects of this class that a scene chooses; none where it leaves them out."""

    def families(self) -> tuple[Family, ...]:
        """Elastic families that the effect adds to the links."""
        return ()

    def joint_stiffness(self) -> casadi.SX | None:
        """Stiffness of each transmission [N m/rad] if the effect makes them elastic; None if it doesn't."""
        return None

    def shortening(self, family: Family) -> casadi.SX | None:
        """Matrix S (K, K) [1/m] if the family's links become shorter by q' S q / 2; None if they don't."""
        return None

    def end_effector_mass(self) -> casadi.SX:
        """Mass that moves with the end effector [kg]; it scales the error norm."""
        return casadi.SX(0)

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """T [J]."""
        return casadi.SX(0)

    def first_moment(self, robot: Robot) -> casadi.SX:
        """Sum of mass times position (2, 1) [kg m], for gravity."""
        return casadi.SX(np.zeros((2, 1)))

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        """V [J]; `first_moment` is the sum over all effects."""
        return casadi.SX(0)

    def dissipation(self, robot: Robot) -> casadi.SX:
        """Rayleigh's function R [W], half the power that is lost."""
        return casadi.SX(0)

    def stiction(self) -> Sequence[Stiction]:
        """Dry friction that can hold motor 1 and motor 2, whose torques are in `dissipation`; or nothing."""
        return ()

    def outputs(self, robot: Robot) -> Sequence[Output]:
        """Outputs that follow from the effect's coordinates."""
        return ()


def column(entries: Sequence[casadi.SX]) -> casadi.SX:
    """A column vector (K, 1) that may be empty, where CasADi is particular about shapes."""
    return casadi.vertcat(casadi.SX(0, 1), *entries)


def symmetric(count: int, entry: Callable[[int, int], casadi.SX], pattern: RealArray) -> casadi.SX:
    """A symmetric matrix with entries only where the pattern is not an exact zero; upper and lower share their symbols."""
    matrix = casadi.SX(count, count)
    for i in range(count):
        for j in range(i, count):
            if pattern[i, j]:
                matrix[i, j] = matrix[j, i] = entry(i, j)
    return matrix


def dot(left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' right, zero for empty vectors."""
    return casadi.dot(left, right) if right.numel() else casadi.SX(0)


def form(matrix: casadi.SX, left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' matrix right, zero for empty vectors."""
    return casadi.bilin(matrix, left, right) if left.numel() and right.numel() else casadi.SX(0)
