"""The five-bar assembled from beam elements, with payload and gravity.

A link is a chain of elements; at a hinge, the nodes of two links share their position, but not their angle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.model.beams import LinkGroup
from flexfmu.model.finite_elements.element import COORDINATES, BeamElement, beam_element, beam_section
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.assembly import bases, elbow
from flexfmu.model.scene.effects import NoDampingSection, StiffnessDampingSection
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.mechanism import Mechanism
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
class Chain:
    """All elements of a link group.

    Attributes:
        element: functions of each element.
        index: indices of the coordinates of each element (E, 6).
    """

    element: BeamElement
    index: Index


@dataclass(frozen=True, eq=False)
class FiniteElementRobot:
    """The five-bar of a scene as beam elements; forces are evaluated for S states at once.

    Attributes:
        scene: the scene; its mode shapes have no meaning here: all links bend and stretch, with foreshortening.
        mesh: indices of the coordinates.
        chains: elements of each link group.
    """

    scene: Scene
    mesh: Mesh
    chains: tuple[Chain, ...]

    def forces(self, x: RealArray, v: RealArray, a: RealArray) -> RealArray:
        """Forces (size, S) that the motion needs, for coordinates, rates and accelerations (size, S) each."""
        # elements of all links
        total = np.zeros(x.shape)
        for chain in self.chains:
            parts = _mapped(chain.element.force, chain.index, x, v, a)
            np.add.at(total, chain.index.T, parts.transpose(1, 2, 0))
        # payload: point mass with its weight, and rotary inertia
        end, payload = list(self.mesh.end), self.scene.payload
        total[end] += payload.mass * (a[end] - np.array(self.scene.effects.gravity)[:, None])
        total[self._payload_angle] += payload.inertia * a[self._payload_angle]
        return total

    def tangents(self, x: RealArray, v: RealArray, a: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Jacobians of the forces by x, v and a, (size, size) each, at one state (size,) each."""
        total = np.zeros((3, self.mesh.size, self.mesh.size))
        for chain in self.chains:
            parts = _mapped(chain.element.tangent, chain.index, x[:, None], v[:, None], a[:, None])[0]
            for index, part in zip(chain.index, parts.T, strict=True):
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
    time = _damping_time(scene)
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
        chains.append(Chain(element, np.vstack([mesh.elements(link) for link in links])))
    return FiniteElementRobot(scene, mesh, tuple(chains))


def _mapped(function: casadi.Function, index: Index, *states: RealArray) -> RealArray:
    """Values of the function for all elements in all states, shape (S, results, E)."""
    count, elements = states[0].shape[1], len(index)
    columns = [z[index].transpose(1, 2, 0).reshape(COORDINATES, count * elements) for z in states]
    result = function.map(count * elements)(*columns).full()
    return np.asarray(result.reshape(-1, count, elements).transpose(1, 0, 2))


def _damping_time(scene: Scene) -> float:
    damping = scene.effects.damping
    if isinstance(damping, StiffnessDampingSection):
        return damping.time
    if isinstance(damping, NoDampingSection):
        return 0.0
    raise SceneError(
        f"finite elements have no damping of the kind '{damping.kind}', which belongs to modes: "
        'set `effects.damping` to { kind = "none" } or { kind = "stiffness", time = ... }'
    )
