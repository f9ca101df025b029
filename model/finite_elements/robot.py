"""The five-bar assembled from co-rotational beam elements, with payload and gravity.

A link is a chain of elements; at a hinge, the nodes of two links share their position, but not their angle.

Deformation of an element is measured from the straight line between its nodes: the elongation, with the shortening due to bending,
and the rotations of both ends. Within the element the deflection is that of a Timoshenko beam under end loads
(Hermite's cubic for infinite shear stiffness); the axial displacement is linear. Forces follow from the virtual work of stress,
weight and inertia, with all inertial terms due to rotation.

Sources: Crisfield, Non-linear Finite Element Analysis of Solids and Structures 1 (1991), chapter 7 (co-rotational
beams); Friedman and Kosmatka, An improved two-node Timoshenko beam finite element, Comput. Struct. 47 (1993)
(deflection with shear); Le, Battini and Hjiaj, Efficient formulation for dynamics of corotational 2D beams, Comput.
Mech. 48 (2011) (inertia).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.model.beams import LinkGroup, shear_coefficient
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.assembly import bases, elbow
from flexfmu.model.scene.effects import NoDampingSection, StiffnessDampingSection
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.mechanism import LinkSection, Mechanism
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.jets import Jet, RealArray

Index = NDArray[np.intp]

KNOWN = ("gravity", "payload.inertia", "damping")
"""Loads that this formulation supports."""


BASES = ((0, 1), (3, 4))
"""Indices of the x and y coordinates of both bases."""

MOTORS = (2, 5)
"""Indices of the motor angles: the angles at the roots of the proximal links."""

HELD = 6
"""Number of prescribed coordinates (bases and motors); they come first."""


@dataclass(frozen=True)
class Mesh:
    """Indices of all coordinates.

    Attributes:
        size: number of coordinates.
        nodes: link name → indices of x, y, theta of its nodes (elements + 1, 3).
        end: indices of the end effector's x and y.
    """

    size: int
    nodes: dict[str, Index]
    end: tuple[int, int]

    def elements(self, link: str) -> Index:
        """Indices of the coordinates of each element of a link (elements, 6)."""
        nodes = self.nodes[link]
        return np.hstack([nodes[:-1], nodes[1:]])


def five_bar_mesh(elements: int) -> Mesh:
    """The mesh with `elements` elements per link; hinged nodes share their positions."""
    # bases and motors come first, then the end effector, then the nodes of each link
    free = iter(range(HELD, HELD + 100 * (elements + 1)))
    end = (next(free), next(free))
    nodes = {}
    for leg in (1, 2):
        root = [*BASES[leg - 1], MOTORS[leg - 1]]
        proximal = [root, *([next(free) for _ in range(3)] for _ in range(elements))]
        elbow = proximal[-1][:2]
        between = [[next(free) for _ in range(3)] for _ in range(elements - 1)]
        distal = [[*elbow, next(free)], *between, [*end, next(free)]]
        nodes[f"link{leg}1"], nodes[f"link{leg}2"] = np.array(proximal), np.array(distal)
    return Mesh(next(free), nodes, end)


LINKS: dict[LinkGroup, tuple[str, str]] = {"proximal": ("link11", "link21"), "distal": ("link12", "link22")}


def rigid_links(mechanism: Mechanism, joints: RealArray) -> Iterator[tuple[LinkGroup, str, Point, Point]]:
    """Group, name, root and tip [m] of all links of the rigid robot, with the motors at the angles (2,) [rad]."""
    fore = RigidKinematics(mechanism).end_effector(*(Jet.constant([q], 0) for q in joints))
    end = float(fore[0].coefficients[0, 0]), float(fore[1].coefficients[0, 0])
    for leg, (base, q) in enumerate(zip(bases(mechanism), joints, strict=True)):
        middle = elbow(base, float(q), mechanism.proximal.length)
        yield "proximal", LINKS["proximal"][leg], base, middle
        yield "distal", LINKS["distal"][leg], middle, end


def straight(root: Point, tip: Point, elements: int) -> RealArray:
    """Positions (elements + 1, 2) [m] of equally spaced nodes on a straight line."""
    fraction = np.linspace(0.0, 1.0, elements + 1)[:, None]
    return np.asarray(np.array(root) * (1.0 - fraction) + np.array(tip) * fraction)


@dataclass(frozen=True, eq=False)
class FiniteElementRobot:
    """The five-bar of a scene as beam elements; forces are evaluated for S states at once.

    Attributes:
        scene: the scene; its mode shapes have no meaning here: all links bend and stretch, with foreshortening.
        mesh: indices of the coordinates.
        chains: functions of an element of each link group, and indices of the coordinates of all its elements (E, 6).
    """

    scene: Scene
    mesh: Mesh
    chains: tuple[tuple[BeamElement, Index], ...]

    def forces(self, x: RealArray, v: RealArray, a: RealArray) -> RealArray:
        """Forces (size, S) that the motion needs, for coordinates, rates and accelerations (size, S) each."""
        # elements of all links
        total = np.zeros(x.shape)
        for element, indices in self.chains:
            parts = _mapped(element.force, indices, x, v, a)
            np.add.at(total, indices.T, parts.transpose(1, 2, 0))
        # payload: point mass with its weight, and rotary inertia
        end, payload = list(self.mesh.end), self.scene.payload
        total[end] += payload.mass * (a[end] - np.array(self.scene.effects.gravity)[:, None])
        total[self._payload_angle] += payload.inertia * a[self._payload_angle]
        return total

    def tangents(self, x: RealArray, v: RealArray, a: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Jacobians of the forces by x, v and a, (size, size) each, at one state (size,) each."""
        total = np.zeros((3, self.mesh.size, self.mesh.size))
        for element, indices in self.chains:
            parts = _mapped(element.tangent, indices, x[:, None], v[:, None], a[:, None])[0]
            for index, part in zip(indices, parts.T, strict=True):
                # Jacobians by x, v and a, column by column
                blocks = part.reshape(3, COORDINATES, COORDINATES)
                total[:, index[:, None], index[None, :]] += blocks.transpose(0, 2, 1)
        for i in self.mesh.end:
            total[2, i, i] += self.scene.payload.mass
        total[2, self._payload_angle, self._payload_angle] += self.scene.payload.inertia
        return total[0], total[1], total[2]

    def undeformed(self, joints: RealArray) -> RealArray:
        """Coordinates (size,) of the rigid robot with the motors at the angles (2,) [rad]."""
        x = np.zeros(self.mesh.size)
        for _, link, root, tip in rigid_links(self.scene.mechanism, joints):
            nodes = self.mesh.nodes[link]
            x[nodes[:, :2]] = straight(root, tip, len(nodes) - 1)
            x[nodes[:, 2]] = np.arctan2(tip[1] - root[1], tip[0] - root[0])
        x[list(MOTORS)] = joints
        return x

    @property
    def _payload_angle(self) -> int:
        """Index of the payload's angle: that of the tip of link 12."""
        return int(self.mesh.nodes["link12"][-1, 2])


def finite_element_robot(scene: Scene, elements: int) -> FiniteElementRobot:
    """The robot of a scene with `elements` elements per link.

    Raises:
        SceneError: the scene has damping or drive effects that this formulation doesn't have.
    """
    # damping and loads that the formulation supports
    damping = scene.effects.damping
    if not isinstance(damping, StiffnessDampingSection | NoDampingSection):
        raise SceneError(
            f"finite elements have no damping of the kind '{damping.kind}', which belongs to modes: "
            'set `effects.damping` to { kind = "none" } or { kind = "stiffness", time = ... }'
        )
    time = damping.time if isinstance(damping, StiffnessDampingSection) else 0.0
    for key in scene.loads:
        if key not in KNOWN:
            raise SceneError(
                f"finite elements are driven by angles of the links: leave `effects.{key}` out of the scene"
            )
    # elements of each link group
    mesh, chains = five_bar_mesh(elements), []
    for group, links in LINKS.items():
        section = beam_section(scene, group)
        element = beam_element(section, section.length / elements, scene.effects.gravity, time)
        chains.append((element, np.vstack([mesh.elements(link) for link in links])))
    return FiniteElementRobot(scene, mesh, tuple(chains))


def _mapped(function: casadi.Function, index: Index, *states: RealArray) -> RealArray:
    """Values of the function for all elements in all states, shape (S, results, E)."""
    count, elements = states[0].shape[1], len(index)
    columns = [z[index].transpose(1, 2, 0).reshape(COORDINATES, count * elements) for z in states]
    result = _repeated(function, count * elements)(*columns).full()
    return np.asarray(result.reshape(-1, count, elements).transpose(1, 0, 2))


@lru_cache(maxsize=64)
def _repeated(function: casadi.Function, count: int) -> casadi.Function:
    """The function of so many columns at once, made once for each number."""
    return function.map(count)


COORDINATES = 6
"""Number of coordinates of an element: x, y, theta of both nodes."""

POINTS, WEIGHTS = (np.polynomial.legendre.leggauss(4)[i] for i in range(2))
POINTS, WEIGHTS = 0.5 * (POINTS + 1.0), 0.5 * WEIGHTS
"""Gauss-Legendre quadrature over 0..1, exact for polynomials up to degree 7: displacements times shapes have degree 6, squared slopes 4."""


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
    # places and angles of cross-sections with their inertia and gravity
    x, v, a = (casadi.SX.sym(name, COORDINATES) for name in "xva")
    shear = 0.0 if np.isinf(section.shear) else 12.0 * section.bending / (section.shear * length**2)
    places = casadi.vertcat(*(_section(length, shear, x, xi) for xi in POINTS))
    inertia = length * np.kron(WEIGHTS, [section.mass, section.mass, section.rotary])
    field = casadi.SX([*gravity, 0.0] * len(POINTS))
    # stress resultants of the deformation and its rate
    deformation, stiffness = _deformation(length, shear, x), casadi.SX(_stiffness(section, length, shear))
    stress = stiffness @ (deformation + damping_time * casadi.jtimes(deformation, x, v))
    # virtual work of inertia, weight and stress, and its Jacobians for Newton's method
    velocities = casadi.jtimes(places, x, v)
    accelerations = casadi.jtimes(velocities, x, v) + casadi.jtimes(places, x, a)
    force = casadi.jtimes(places, x, inertia * (accelerations - field), True)
    force = casadi.cse(force + casadi.jtimes(deformation, x, stress, True))
    tangent = casadi.vertcat(*(casadi.vec(casadi.jacobian(force, z)) for z in (x, v, a)))
    kinetic = 0.5 * casadi.dot(inertia, velocities**2)
    potential = 0.5 * casadi.dot(deformation, stiffness @ deformation) - casadi.dot(inertia * field, places)
    return BeamElement(
        force=_function("force", [x, v, a], force),
        tangent=_function("tangent", [x, v, a], tangent),
        energy=_function("energy", [x, v], casadi.vertcat(kinetic, potential)),
    )


def _function(name: str, arguments: list[casadi.SX], result: casadi.SX) -> casadi.Function:
    return casadi.Function(name, arguments, [casadi.densify(result)])


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


def _section(length: float, shear: float, x: casadi.SX, xi: float) -> casadi.SX:
    """Position of the axis [m] and angle of the cross-section, up to whole turns [rad], at xi in 0..1, (3, 1)."""
    line, (value, _, turning) = x[3:5] - x[0:2], map(casadi.SX, _deflection(shear, xi))
    normal = casadi.vertcat(-line[1], line[0]) / casadi.norm_2(line)
    ends = _ends(x)
    across = length * casadi.dot(value, ends)
    angle = casadi.atan2(line[1], line[0]) + casadi.dot(turning, ends)
    return casadi.vertcat(x[0:2] + xi * line + across * normal, angle)


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
