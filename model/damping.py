"""Structural damping of the elastic coordinates."""

from __future__ import annotations

from abc import abstractmethod

import casadi
import numpy as np

from flexfmu.model.algebra import form, symmetric
from flexfmu.model.effects import Effect
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Family, Robot
from flexfmu.model.symbolic import Variable


class StructuralDamping(Effect):
    """Damping of every elastic family, after a law that a subclass gives."""

    def dissipation(self, robot: Robot) -> casadi.SX:
        return sum((self._power(part.family, part.v) for _, part in robot.elastic), casadi.SX(0))

    @abstractmethod
    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        """Rayleigh's function [W] of one family on one link, for modal rates v (K, 1)."""


class ModalDamping(StructuralDamping):
    """Modal damping C_ii = 2 ratio sqrt(K_ii M_ii) of every mode of every link."""

    def __init__(self, registry: ParameterRegistry, ratio: float) -> None:
        self._registry = registry
        self._ratio = registry.parameter(
            Variable(
                "damping.ratio",
                "1",
                "Modal damping ratio of the link modes",
                "parameter",
                start=ratio,
                minimum=0.0,
                maximum=1.0,
            )
        )

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        total = casadi.SX(0)
        for k in range(v.numel()):
            c = 2 * self._ratio * casadi.sqrt(family.stiffness[k, k] * family.mass[k, k])
            total += 0.5 * self._registry.derived(f"{family.group}_{family.direction}_c_{k}", c) * v[k] ** 2
        return total


class StiffnessDamping(StructuralDamping):
    """Stiffness-proportional damping C = time * K on the elastic coordinates."""

    def __init__(self, registry: ParameterRegistry, time: float) -> None:
        self._registry = registry
        self._time = registry.parameter(
            Variable(
                "damping.time",
                "s",
                "Stiffness-proportional damping time",
                "parameter",
                start=time,
                minimum=0.0,
                maximum=1e3,
            )
        )

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        prefix, stiffness = f"{family.group}_{family.direction}_c", family.stiffness
        damping = symmetric(
            v.numel(),
            lambda i, j: self._registry.derived(f"{prefix}_{i}_{j}", self._time * stiffness[i, j]),
            np.array(casadi.DM(stiffness.sparsity(), 1.0).full()),
        )
        return 0.5 * form(damping, v, v)
