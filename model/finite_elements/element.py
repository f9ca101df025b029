"""Cross section of a link, and a co-rotational beam element between two nodes (x, y, theta) in the fixed frame.

Deformation is measured from the straight line between the nodes: the elongation, with the shortening due to bending,
and the rotations of both ends. Within the element the deflection is that of a Timoshenko beam under end loads
(Hermite's cubic for infinite shear stiffness); the axial displacement is linear. Forces follow from the energies by
Lagrange's equations, with all inertial terms due to rotation.

Sources: Crisfield, Non-linear Finite Element Analysis of Solids and Structures 1 (1991), chapter 7 (co-rotational
beams); Friedman and Kosmatka, An improved two-node Timoshenko beam finite element, Comput. Struct. 47 (1993)
(deflection with shear); Le, Battini and Hjiaj, Efficient formulation for dynamics of corotational 2D beams, Comput.
Mech. 48 (2011) (inertia).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import casadi
import numpy as np

from flexfmu.model.beams import LinkGroup, shear_coefficient
from flexfmu.model.scene.mechanism import LinkSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

COORDINATES = 6
"""Number of coordinates of an element: x, y, theta of both nodes."""

POINTS, WEIGHTS = (np.polynomial.legendre.leggauss(5)[i] for i in range(2))
POINTS, WEIGHTS = 0.5 * (POINTS + 1.0), 0.5 * WEIGHTS
"""Gauss-Legendre quadrature over 0..1, exact for polynomials up to degree 9."""


@dataclass(frozen=True)
class BeamSection:
    """Cross-section properties and length of a uniform link.

    Attributes:
        length: length of the link l [m].
        axial: axial rigidity EA [N].
        bending: bending rigidity EI [N m²].
        shear: shear rigidity kGA [N]; infinite for an Euler-Bernoulli beam.
        mass: mass per length rho A [kg/m].
        rotary: rotary inertia per length rho I [kg m]; zero for an Euler-Bernoulli beam.
    """

    length: float
    axial: float
    bending: float
    shear: float
    mass: float
    rotary: float


def beam_section(scene: Scene, group: LinkGroup) -> BeamSection:
    """The section of a link group, with shear and rotary inertia where ``effects.beam`` is ``timoshenko``."""
    # area and second moment of the tube
    link: LinkSection = getattr(scene.mechanism, group)
    outer, inner, material = link.diameter, link.inner_diameter, scene.mechanism.material
    area = math.pi / 4.0 * (outer**2 - inner**2)
    second = math.pi / 64.0 * (outer**4 - inner**4)
    # shear and rotary inertia of a Timoshenko beam
    young, nu, density = material.youngs_modulus, material.poissons_ratio, material.density
    thick = scene.effects.beam == "timoshenko"
    shear = shear_coefficient(outer, inner, nu) * young / (2.0 * (1.0 + nu)) * area
    return BeamSection(
        length=link.length,
        axial=young * area,
        bending=young * second,
        shear=shear if thick else math.inf,
        mass=density * area,
        rotary=density * second if thick else 0.0,
    )


@dataclass(frozen=True)
class BeamElement:
    """Functions of one element's coordinates x, rates v and accelerations a (6, 1) each.

    Attributes:
        force: (x, v, a) → nodal forces (6, 1) that the motion needs.
        tangent: (x, v, a) → Jacobians of the force by x, v and a, column by column (108, 1).
        energy: (x, v) → kinetic and potential energy [J].
    """

    force: casadi.Function
    tangent: casadi.Function
    energy: casadi.Function


@lru_cache(maxsize=32)
def beam_element(section: BeamSection, length: float, gravity: tuple[float, float], damping_time: float) -> BeamElement:
    """The functions of one element of a link.

    Args:
        section: section of the link.
        length: undeformed length of the element [m].
        gravity: gravitational acceleration [m/s²].
        damping_time: retardation time of the Kelvin-Voigt material [s].
    """
    # energies and dissipation
    x, v, a = (casadi.SX.sym(name, COORDINATES) for name in "xva")
    shear = 0.0 if np.isinf(section.shear) else 12.0 * section.bending / (section.shear * length**2)
    kinetic = _kinetic_energy(section, length, shear, x, v)
    deformation = _deformation(length, shear, x)
    potential = 0.5 * _form(_stiffness(section, length, shear), deformation)
    points = (w * _point(length, shear, x, xi) for xi, w in zip(POINTS, WEIGHTS, strict=True))
    potential -= section.mass * length * casadi.dot(casadi.SX(list(gravity)), sum(points, casadi.SX(2, 1)))
    lost = 0.5 * damping_time * _form(_stiffness(section, length, shear), casadi.jtimes(deformation, x, v))
    # Lagrange's equations, and their Jacobians for Newton's method
    momentum = casadi.gradient(kinetic, v)
    force = casadi.jtimes(momentum, x, v) + casadi.jtimes(momentum, v, a)
    force += casadi.gradient(potential - kinetic, x) + casadi.gradient(lost, v)
    tangent = casadi.vertcat(*(casadi.vec(casadi.jacobian(force, z)) for z in (x, v, a)))
    return BeamElement(
        force=_function("force", [x, v, a], force),
        tangent=_function("tangent", [x, v, a], tangent),
        energy=_function("energy", [x, v], casadi.vertcat(kinetic, potential)),
    )


def _function(name: str, arguments: list[casadi.SX], result: casadi.SX) -> casadi.Function:
    return casadi.Function(name, arguments, [casadi.densify(casadi.cse(result))])


def _kinetic_energy(section: BeamSection, length: float, shear: float, x: casadi.SX, v: casadi.SX) -> casadi.SX:
    """Kinetic energy of the displacements and of the rotation of the sections [J]."""
    total, line = casadi.SX(0), x[3:5] - x[0:2]
    for xi, weight in zip(POINTS, WEIGHTS, strict=True):
        velocity = casadi.jtimes(_point(length, shear, x, xi), x, v)
        # angle of the cross section, up to whole turns
        angle = casadi.atan2(line[1], line[0]) + casadi.dot(casadi.SX(_deflection(shear, xi)[2]), _ends(x))
        rate = casadi.jtimes(angle, x, v)
        density = section.mass * casadi.dot(velocity, velocity) + section.rotary * rate**2
        total += 0.5 * weight * length * density
    return total


def _deformation(length: float, shear: float, x: casadi.SX) -> casadi.SX:
    """Elongation [m], and rotations of both ends [rad] relative to the line between the nodes, (3, 1).

    The axis is longer than this line by half the integral of the squared slope.
    """
    line, ends = x[3:5] - x[0:2], _ends(x)
    slopes = np.array([_deflection(shear, xi)[1] for xi in POINTS])
    bowing = _form(length * (slopes.T * WEIGHTS) @ slopes, ends)
    square = casadi.dot(line, line)
    # L - l from the difference of squares: no cancellation of nearly equal lengths
    elongation = (square - length**2) / (casadi.sqrt(square) + length)
    return casadi.vertcat(elongation + 0.5 * bowing, ends)


def _stiffness(section: BeamSection, length: float, shear: float) -> RealArray:
    """Stiffness matrix of the deformation (3, 3)."""
    bending = section.bending / (length * (1.0 + shear)) * np.array([[4 + shear, 2 - shear], [2 - shear, 4 + shear]])
    matrix = np.zeros((3, 3))
    matrix[0, 0], matrix[1:, 1:] = section.axial / length, bending
    return matrix


def _ends(x: casadi.SX) -> casadi.SX:
    """Rotations of both ends relative to the line between the nodes, within ±pi [rad], (2, 1)."""
    line = x[3:5] - x[0:2]
    turned = []
    for theta in (x[2], x[5]):
        c, s = casadi.cos(theta), casadi.sin(theta)
        turned.append(casadi.atan2(line[0] * s - line[1] * c, line[0] * c + line[1] * s))
    return casadi.vertcat(*turned)


def _point(length: float, shear: float, x: casadi.SX, xi: float) -> casadi.SX:
    """Position (2, 1) [m] of the axis at xi in 0..1."""
    line = x[3:5] - x[0:2]
    normal = casadi.vertcat(-line[1], line[0]) / casadi.norm_2(line)
    across = length * casadi.dot(casadi.SX(_deflection(shear, xi)[0]), _ends(x))
    return x[0:2] + xi * line + across * normal


def _deflection(shear: float, xi: float) -> tuple[RealArray, RealArray, RealArray]:
    """Deflection / length, slope and section rotation at xi, per unit rotation of each end, (2,) each."""
    s = shear
    value = np.array([xi**3 - (2 + s / 2) * xi**2 + (1 + s / 2) * xi, xi**3 - (1 - s / 2) * xi**2 - s / 2 * xi])
    slope = np.array([3 * xi**2 - (4 + s) * xi + 1 + s / 2, 3 * xi**2 - (2 - s) * xi - s / 2])
    turning = np.array([3 * xi**2 - (4 + s) * xi + 1 + s, 3 * xi**2 - (2 - s) * xi])
    return value / (1 + s), slope / (1 + s), turning / (1 + s)


def _form(matrix: RealArray, vector: casadi.SX) -> casadi.SX:
    """vector' matrix vector."""
    return casadi.dot(vector, casadi.SX(matrix) @ vector)
