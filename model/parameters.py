"""Parameters of the model in two layers: FMI parameters p, and derived values d, computed once from p.

The parameters of the mechanism give the properties of the links; all others belong to effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi

from flexfmu.model.beams import LinkGroup
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.section import LARGEST, SMALLEST
from flexfmu.model.symbolic import Variable


class ParameterRegistry:
    """Parameters and derived values that the effects register while a model is assembled.

    Derived values are symbols in the equations of motion; their expressions go into the function ``derive(p) -> d``.
    """

    def __init__(self) -> None:
        self._variables: dict[str, Variable] = {}
        self._symbols: dict[str, casadi.SX] = {}
        self._derived: dict[str, tuple[casadi.SX, casadi.SX]] = {}

    def parameter(self, variable: Variable) -> casadi.SX:
        """The symbol of an FMI parameter; a second registration of the same variable returns the same symbol.

        Raises:
            ValueError: the name is registered with other attributes."""
        known = self._variables.setdefault(variable.name, variable)
        if known != variable:
            raise ValueError(f"parameter `{variable.name}` is declared twice with different attributes")
        return self._symbols.setdefault(variable.name, casadi.SX.sym(variable.name))

    def quantity(
        self, name: str, unit: str, text: str, start: float, minimum: float = 0.0, maximum: float = LARGEST
    ) -> casadi.SX:
        """Register an effect's parameter, named like its scene key; returns its symbol among the derived values."""
        variable = Variable(name, unit, text, "parameter", start=start, minimum=minimum, maximum=maximum)
        return self.derived(name.replace(".", "_"), self.parameter(variable))

    def derived(self, name: str, expression: casadi.SX) -> casadi.SX:
        """The symbol of a value that is computed once from the parameters; a known name returns its first symbol.

        A constant expression (without parameters) is returned as it is.
        """
        if casadi.SX(expression).is_constant():
            return casadi.SX(expression)
        if name not in self._derived:
            self._derived[name] = (casadi.SX.sym(name), expression)
        return self._derived[name][0]

    def switch(self, name: str) -> casadi.SX:
        """The symbol of a derived value that starts at zero; the runtime sets it during the simulation."""
        return self._derived.setdefault(name, (casadi.SX.sym(name), casadi.SX(0)))[0]

    def position(self, derived: casadi.SX) -> int:
        """Index of a derived value's symbol in d."""
        return next(i for i, (symbol, _) in enumerate(self._derived.values()) if casadi.is_equal(symbol, derived))

    def find_derived(self, name: str) -> casadi.SX:
        """The symbol of a derived value; zero if it isn't registered."""
        return self._derived[name][0] if name in self._derived else casadi.SX(0)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The FMI parameters in the order of p."""
        return tuple(self._variables.values())

    @property
    def p(self) -> casadi.SX:
        """Symbols of all parameters, shape (n_parameters, 1)."""
        return casadi.vertcat(*(self._symbols[name] for name in self._variables))

    @property
    def d(self) -> casadi.SX:
        """Symbols of all derived values, shape (n_derived, 1)."""
        return casadi.vertcat(*(symbol for symbol, _ in self._derived.values()))

    def derived_at_start(self) -> casadi.DM:
        """The derived values at the parameters' start values, shape (n_derived, 1)."""
        derive = casadi.Function("derive", [self.p], [self.resolved()])
        return derive([float(v.start) for v in self._variables.values() if v.start is not None])

    def resolved(self) -> casadi.SX:
        """The derived values as expressions of the parameters alone, shape (n_derived, 1)."""
        expressions: list[casadi.SX] = []
        symbols: list[casadi.SX] = []
        for symbol, expression in self._derived.values():
            known = casadi.vertcat(*symbols), casadi.vertcat(*expressions)
            expressions.append(casadi.substitute(expression, *known) if symbols else expression)
            symbols.append(symbol)
        return casadi.vertcat(*expressions)


def mechanism_parameters(registry: ParameterRegistry, mechanism: Mechanism) -> dict[str, casadi.SX]:
    """Register the parameters of the mechanism: lengths, diameters and material; returns name → symbol."""
    half, material = mechanism.base_half_distance, mechanism.material
    variables = [_positive("base_half_distance", "m", "Half of the distance between the bases", half, 1e3)]
    # rods and tubes
    for group, link in (("proximal", mechanism.proximal), ("distal", mechanism.distal)):
        inner, text = f"{group}.inner_diameter", f"Inner diameter of the {group} links, 0 for solid rods"
        variables += [
            _positive(f"{group}.length", "m", f"Length of the {group} links", link.length, 1e3),
            _positive(f"{group}.diameter", "m", f"Outer diameter of the {group} links", link.diameter, 1e2),
            Variable(inner, "m", text, "parameter", start=link.inner_diameter, minimum=0.0, maximum=1e2),
        ]
    young, modulus = "Young's modulus of the links", material.youngs_modulus
    variables += [
        _positive("material.density", "kg/m3", "Density of the links", material.density, 1e6),
        _positive("material.youngs_modulus", "Pa", young, modulus, 1e15),
    ]
    # symbols by name
    return {variable.name: registry.parameter(variable) for variable in variables}


def _positive(name: str, unit: str, description: str, start: float, maximum: float) -> Variable:
    """A parameter above zero; FMI ranges are closed, so the minimum is tiny instead."""
    return Variable(name, unit, description, "parameter", start=start, minimum=SMALLEST, maximum=maximum)


@dataclass(frozen=True)
class LinkProperties:
    """Mass [kg], length, diameters [m], area [m²], second moment of area [m⁴] and Young's modulus [Pa] of a group."""

    mass: casadi.SX
    length: casadi.SX
    outer_diameter: casadi.SX
    inner_diameter: casadi.SX
    area: casadi.SX
    second_moment: casadi.SX
    youngs_modulus: casadi.SX


def link_properties(
    registry: ParameterRegistry, group: LinkGroup, parameters: Mapping[str, casadi.SX]
) -> LinkProperties:
    """Properties of round rods or tubes; registers mass and length as derived values."""
    # dimensions and cross section
    outer, inner, length = (parameters[f"{group}.{key}"] for key in ("diameter", "inner_diameter", "length"))
    area = math.pi / 4 * (outer**2 - inner**2)
    return LinkProperties(
        mass=registry.derived(f"{group}_mass", parameters["material.density"] * area * length),
        length=registry.derived(f"{group}_length", length),
        outer_diameter=outer,
        inner_diameter=inner,
        area=area,
        second_moment=math.pi / 64 * (outer**4 - inner**4),
        youngs_modulus=parameters["material.youngs_modulus"],
    )
