"""The five-bar as Exudyn describes it: planar ANCF cable elements, hinges and motors as algebraic joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from exudyn import OutputVariableType, SystemContainer
from exudyn.itemInterface import (
    LoadMassProportional,
    MarkerBodyMass,
    MarkerBodyRigid,
    MarkerNodePosition,
    MarkerNodeRigid,
    NodePoint2DSlope1,
    ObjectANCFCable2D,
    ObjectGround,
    ObjectJointGeneric,
    ObjectJointRevolute2D,
    ObjectMassPoint2D,
    SensorNode,
    SensorObject,
)
from numpy.typing import NDArray

from flexfmu.model.finite_elements.placement import rigid_links, straight
from flexfmu.model.finite_elements.sections import BeamSection, beam_section
from flexfmu.model.scene import Scene, StiffnessDamping

Array = NDArray[np.float64]

Offset = Callable[[Any, float, int, Any], list[float]]
"""Exudyn's user function of a joint: (system, time, item, parameters) → displacements and rotations that it prescribes (6,)."""

CLAMP = [1, 1, 0, 0, 0, 1]
"""Directions that a motor prescribes: x, y and turning about z."""


@dataclass(frozen=True)
class ExudynMechanism:
    """What Exudyn integrates, the container that owns it, and sensors of position, acceleration and both torques."""

    container: Any
    system: Any
    sensors: list[Any]

    def recorded(self, sensor: Any) -> Array:
        """Values at the ends of all steps, the start first."""
        return np.asarray(self.system.GetSensorStoredData(sensor)[:, 1:], dtype=float)


def exudyn_mechanism(scene: Scene, elements: int, start: Array, offsets: Sequence[Offset]) -> ExudynMechanism:
    """A scene's robot with so many elements a link, at the joint angles `start` (2,) [rad], driven by the motors' offsets."""
    container = SystemContainer()
    system = container.AddSystem()
    gravity = [*scene.effects.gravity, 0.0]
    ends, roots = {}, {}
    for group, link, root, tip in rigid_links(scene.mechanism, start):
        nodes = _nodes(system, straight(root, tip, elements))
        _beams(system, nodes, beam_section(scene, group), _damping_time(scene), gravity)
        ends[link], roots[link] = (nodes[0], nodes[-1]), root
    joints = []
    for leg in (1, 2):
        proximal, distal = ends[f"link{leg}1"], ends[f"link{leg}2"]
        joints.append(_motor(system, roots[f"link{leg}1"], proximal[0], offsets[leg - 1]))
        _hinge(system, proximal[1], distal[0])
    end = ends["link12"][1]
    _hinge(system, end, ends["link22"][1])
    if scene.payload.mass:
        _weigh(system, system.AddObject(ObjectMassPoint2D(mass=scene.payload.mass, nodeNumber=end)), gravity)
    mechanism = ExudynMechanism(container, system, [system.AddSensor(sensor) for sensor in _sensors(end, joints)])
    system.Assemble()
    return mechanism


def _sensors(end: Any, joints: list[Any]) -> list[Any]:
    """Of the end effector's position and acceleration, and of the motors' torques."""
    kinds, torque = (OutputVariableType.Position, OutputVariableType.Acceleration), OutputVariableType.TorqueLocal
    return [
        *(SensorNode(nodeNumber=end, storeInternal=True, outputVariableType=kind) for kind in kinds),
        *(SensorObject(objectNumber=joint, storeInternal=True, outputVariableType=torque) for joint in joints),
    ]


def _nodes(system: Any, points: Array) -> list[Any]:
    """Nodes of a straight chain, each with its position and its slope."""
    direction = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    return [system.AddNode(NodePoint2DSlope1(referenceCoordinates=[*point, *direction])) for point in points]


def _beams(system: Any, nodes: list[Any], section: BeamSection, damping_time: float, gravity: list[float]) -> None:
    count = len(nodes) - 1
    for k in range(count):
        beam = ObjectANCFCable2D(
            length=section.length / count,
            massPerLength=section.mass,
            bendingStiffness=section.bending,
            axialStiffness=section.axial,
            bendingDamping=damping_time * section.bending,
            axialDamping=damping_time * section.axial,
            nodeNumbers=nodes[k : k + 2],
            useReducedOrderIntegration=1,
        )
        _weigh(system, system.AddObject(beam), gravity)


def _weigh(system: Any, body: Any, gravity: list[float]) -> None:
    marker = system.AddMarker(MarkerBodyMass(bodyNumber=body))
    system.AddLoad(LoadMassProportional(markerNumber=marker, loadVector=gravity))


def _motor(system: Any, base: tuple[float, float], node: Any, offset: Offset) -> Any:
    """A joint that holds a node at a base and turns its slope as the motor asks."""
    ground = system.AddObject(ObjectGround(referencePosition=[*base, 0.0]))
    markers = [
        system.AddMarker(MarkerBodyRigid(bodyNumber=ground)),
        system.AddMarker(MarkerNodeRigid(nodeNumber=node)),
    ]
    return system.AddObject(ObjectJointGeneric(markerNumbers=markers, constrainedAxes=CLAMP, offsetUserFunction=offset))


def _hinge(system: Any, *nodes: Any) -> None:
    markers = [system.AddMarker(MarkerNodePosition(nodeNumber=node)) for node in nodes]
    system.AddObject(ObjectJointRevolute2D(markerNumbers=markers))


def _damping_time(scene: Scene) -> float:
    damping = scene.effects.damping
    return damping.time if isinstance(damping, StiffnessDamping) else 0.0
