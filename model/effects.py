"""The interface of effects: contributions to coordinates, energies, dissipation and outputs.

The sum of all effects is the model. An effect that a scene leaves out isn't constructed: the model has no state and no
term of it, and the generated C no line. A new effect is a subclass of `Effect`; its key in the scene file and its
registration are in `flexfmu.model.scene.effects`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from flexfmu.model.beams import LinkGroup
from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import Family, Robot, Shortening
from flexfmu.model.scene.effects import RayleighDampingSection, StiffnessDampingSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import EffectNote, Variable


@dataclass(frozen=True)
class Stiction:
    """Dry friction that can hold a motor.

    Attributes:
        torque: motor rate [rad/s] → friction torque [N m], signed like the slip.
        breakaway: largest torque [N m] that holds the motor; a derived value.
        direction: direction of slip, a switch; 0 stands for the sign of the rate.
    """

    torque: Callable[[casadi.SX], casadi.SX]
    breakaway: casadi.SX
    direction: casadi.SX


@dataclass(frozen=True)
class Output:
    """A scalar output that is linear in the elastic coordinates: gain' q.

    Attributes:
        name, unit, description: of the FMI variable.
        coordinates: the elastic coordinates (K, 1) of one link.
        gain: numbers or derived values (K, 1).
    """

    name: str
    unit: str
    description: str
    coordinates: casadi.SX
    gain: casadi.SX


@dataclass(frozen=True)
class EffectContext:
    """Arguments of `Effect.from_scene`.

    Attributes:
        scene: the scene, whose keys choose the effects.
        registry: takes the parameters and derived values of the effects.
        links: properties of the link groups, in symbols.
    """

    scene: Scene
    registry: ParameterRegistry
    links: Mapping[LinkGroup, LinkProperties]

    def damping_time(self) -> casadi.SX | None:
        """Parameter of the damping that is proportional to stiffness [s]; None where the scene has no such damping."""
        damping = self.scene.effects.damping
        if not isinstance(damping, StiffnessDampingSection | RayleighDampingSection) or not damping.time:
            return None
        text = "Stiffness-proportional damping time"
        return self.registry.parameter(
            Variable("damping.time", "s", text, "parameter", start=damping.time, minimum=0.0, maximum=1e3)
        )


class Effect(ABC):
    """One physical effect; by default a hook contributes nothing.

    Attributes:
        note: text for the documentation; an attribute of the instance where it depends on the scene's values, else of
            the class.
    """

    note: EffectNote

    @classmethod
    @abstractmethod
    def from_scene(cls, context: EffectContext) -> Iterable[Effect]:
        """The effects of this class that the scene contains; none where it leaves them out."""

    def families(self) -> tuple[Family, ...]:
        """Elastic families that the effect adds to the links."""
        return ()

    def joint_stiffness(self) -> casadi.SX | None:
        """Stiffness of each transmission [N m/rad] if the effect makes them elastic; None if it doesn't."""
        return None

    def shortening(self, family: Family) -> Shortening | None:
        """How deflections of the family shorten its links; None if they don't."""
        return None

    def end_effector_mass(self) -> casadi.SX:
        """Mass that moves with the end effector [kg]; it scales the error norm."""
        return casadi.SX(0)

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """Kinetic energy T [J]."""
        return casadi.SX(0)

    def first_moment(self, robot: Robot) -> casadi.SX:
        """First moment of mass (2, 1) [kg m]: ∫ X dm, for gravity."""
        return casadi.SX(np.zeros((2, 1)))

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        """Potential energy V [J]; `first_moment` is the sum over all effects."""
        return casadi.SX(0)

    def dissipation(self, robot: Robot) -> casadi.SX:
        """Rayleigh's dissipation function R [W]; its gradient by the rates is the dissipative force."""
        return casadi.SX(0)

    def stiction(self) -> Sequence[Stiction]:
        """Dry friction that can hold motor 1 and motor 2, or none; `dissipation` contains its torques."""
        return ()

    def outputs(self, robot: Robot) -> Sequence[Output]:
        """Outputs of the effect."""
        return ()


def column(entries: Sequence[casadi.SX]) -> casadi.SX:
    """A column vector (K, 1), of shape (0, 1) where there are no entries."""
    return casadi.vertcat(casadi.SX(0, 1), *entries)


def derived_matrix(registry: ParameterRegistry, prefix: str, values: casadi.SX) -> casadi.SX:
    """A symmetric matrix (K, K) as derived values ``prefix_i_j``, without those that are zero; both triangles share their symbols."""
    matrix = casadi.SX(*values.shape)
    for i in range(values.shape[0]):
        for j in range(i, values.shape[0]):
            if not values[i, j].is_zero():
                matrix[i, j] = matrix[j, i] = registry.derived(f"{prefix}_{i}_{j}", values[i, j])
    return matrix


def dot(left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' right, zero for empty vectors."""
    return casadi.dot(left, right) if right.numel() else casadi.SX(0)


def form(matrix: casadi.SX, left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' matrix right, zero for empty vectors."""
    return casadi.bilin(matrix, left, right) if left.numel() and right.numel() else casadi.SX(0)
