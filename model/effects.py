"""What an effect may contribute to the model: coordinates, energies, dissipation and outputs.

Each effect knows nothing of the others; the sum of all effects is the model. An effect that a scene leaves out isn't
constructed, so it leaves no state, no term and no line in the generated C.
"""

from __future__ import annotations

import re
from abc import ABC
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from flexfmu.model.robot import Family, Robot
from flexfmu.model.symbolic import EffectNote


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


class Effect(ABC):  # noqa: B024 - every hook has a neutral default
    """What an effect may contribute; each hook's default is nothing."""

    def families(self) -> tuple[Family, ...]:
        """Elastic families that the effect adds to the links."""
        return ()

    def twists_joints(self) -> bool:
        """Whether the effect makes the joints' transmissions elastic."""
        return False

    def shortening(self, family: Family) -> casadi.SX | None:
        """Matrix S (K, K) [1/m] if the family's links become shorter by q' S q / 2; None if they don't."""
        return None

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
        """Scalars worth watching."""
        return ()

    def title(self) -> str:
        """What the documentation calls the effect, for example ``point payload``."""
        return re.sub(r"(?<!^)(?=[A-Z])", " ", type(self).__name__).lower()

    def sentence(self) -> str:
        """One sentence for the documentation."""
        return (self.__doc__ or "").split("\n")[0]

    def formula(self) -> str:
        """Its energy or dissipation as a person writes it, in Unicode; empty where one sentence says all."""
        return ""

    def note(self) -> EffectNote:
        """All that the documentation says of the effect."""
        given = (
            what for hook, what in _CONTRIBUTIONS.items() if getattr(type(self), hook) is not getattr(Effect, hook)
        )
        return EffectNote(self.title(), self.sentence(), self.formula(), tuple(given))


_CONTRIBUTIONS = {
    "families": "elastic coordinates",
    "twists_joints": "twist of the joints",
    "shortening": "shortening of links",
    "kinetic_energy": "kinetic energy T",
    "first_moment": "weight",
    "potential_energy": "potential energy V",
    "dissipation": "dissipation R",
    "stiction": "sticking of the motors",
    "outputs": "outputs",
}
"""Hook of an effect → what it contributes if it has one of its own."""
