"""Structural damping of the elastic coordinates."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

import casadi

from flexfmu.model.effects import Effect, EffectContext, derived_matrix, form
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Family, Robot
from flexfmu.model.scene import effects as keys
from flexfmu.model.symbolic import EffectNote, Variable


class StructuralDamping(Effect):
    """Damping of every elastic family; a subclass gives the law."""

    def dissipation(self, robot: Robot) -> casadi.SX:
        return sum((self._power(part.family, part.v) for _, part in robot.elastic), casadi.SX(0))

    @abstractmethod
    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        """Rayleigh's dissipation function [W] of one family on one link, for modal rates v (K, 1)."""


class ModalDamping(StructuralDamping):
    """Modal damping C_ii = 2 ratio sqrt(K_ii M_ii) of every mode of every link."""

    note = EffectNote(
        "modal damping",
        "Modal damping C_ii = 2 ratio sqrt(K_ii M_ii) of every mode of every link.",
        "R = ½ ∑ 2ζ √(K_kk M_kk) q̇_k²",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        damping = context.scene.effects.damping
        if isinstance(damping, keys.ModalDampingSection) and damping.ratio:
            yield cls(context.registry, damping.ratio)

    def __init__(self, registry: ParameterRegistry, ratio: float) -> None:
        self._registry = registry
        text = "Modal damping ratio of the link modes"
        self._ratio = registry.parameter(_factor("damping.ratio", "1", text, ratio, 1e3))

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        total = casadi.SX(0)
        for k in range(v.numel()):
            c = 2 * self._ratio * casadi.sqrt(family.stiffness[k, k] * family.mass[k, k])
            total += 0.5 * self._registry.derived(f"{family.group}_{family.direction}_c_{k}", c) * v[k] ** 2
        return total


class ProportionalDamping(StructuralDamping):
    """Damping C = rate * M + time * K on the elastic coordinates, with the links' own modal masses (Rayleigh)."""

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        damping = context.scene.effects.damping
        rate = damping.rate if isinstance(damping, keys.MassDampingSection | keys.RayleighDampingSection) else 0.0
        time = damping.time if isinstance(damping, keys.StiffnessDampingSection | keys.RayleighDampingSection) else 0.0
        if rate or time:
            yield cls(context.registry, rate, time)

    def __init__(self, registry: ParameterRegistry, rate: float, time: float) -> None:
        """A factor of zero removes its term; `rate` in 1/s, `time` in s."""
        # parameters of the terms that the scene has
        self._registry, self._has_rate, self._has_time = registry, bool(rate), bool(time)
        if rate:
            self._rate = registry.parameter(_factor("damping.rate", "1/s", "Mass-proportional damping rate", rate, 1e6))
        if time:
            text = "Stiffness-proportional damping time"
            self._time = registry.parameter(_factor("damping.time", "s", text, time, 1e3))
        # the note names these terms
        terms = [(kind, symbol) for kind, symbol, there in (("mass", "αM", rate), ("stiffness", "βK", time)) if there]
        self.note = EffectNote(
            " and ".join(kind for kind, _ in terms) + " proportional damping",
            "Damping C = rate * M + time * K on the elastic coordinates, with the links' own modal masses (Rayleigh).",
            f"R = ½ q̇ᵀ ({' + '.join(symbol for _, symbol in terms)}) q̇",
        )

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        damping = casadi.SX(*family.stiffness.shape)
        if self._has_rate:
            damping += self._rate * family.mass
        if self._has_time:
            damping += self._time * family.stiffness
        derived = derived_matrix(self._registry, f"{family.group}_{family.direction}_c", damping)
        return 0.5 * form(derived, v, v)


def _factor(name: str, unit: str, text: str, start: float, maximum: float) -> Variable:
    return Variable(name, unit, text, "parameter", start=start, minimum=0.0, maximum=maximum)
