"""The same mechanism in Exudyn: planar ANCF cable elements, algebraic joints, generalised-alpha with a fixed step.

Its beams are Euler and Bernoulli's, in absolute coordinates, so that foreshortening is in them; they have no shear. Damping
proportional to stiffness is the same as here, modal damping isn't there.

Sources: Gerstmayr, Exudyn: a C++ based Python package for flexible multibody systems, Multibody Syst. Dyn. (2023); Gerstmayr
and Irschik, On the correct representation of bending and axial deformation in the absolute nodal coordinate formulation with
an elastic line approach, J. Sound Vib. 318 (2008).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from exudyn import ConfigurationType, OutputVariableType, SimulationSettings, SolverError, SystemContainer
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

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.studies.workprec.trial import RunError
from flexfmu.model.finite_elements.robot import BeamSection, beam_section, rigid_links, straight
from flexfmu.model.scene.effects import StiffnessDampingSection
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene

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

    def recorded(self, sensor: Any) -> RealArray:
        """Values at the ends of all steps, the start first."""
        return np.asarray(self.system.GetSensorStoredData(sensor)[:, 1:], dtype=float)


def exudyn_mechanism(scene: Scene, elements: int, start: RealArray, offsets: Sequence[Offset]) -> ExudynMechanism:
    """A scene's robot with so many elements a link, at the joint angles `start` (2,) [rad], driven by the motors' offsets."""
    container = SystemContainer()
    system = container.AddSystem()
    gravity = [*scene.effects.gravity, 0.0]
    # links as chains of beam elements
    ends, roots = {}, {}
    damping = scene.effects.damping
    damping_time = damping.time if isinstance(damping, StiffnessDampingSection) else 0.0
    for group, link, root, tip in rigid_links(scene.mechanism, start):
        points = straight(root, tip, elements)
        direction = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        nodes = [system.AddNode(NodePoint2DSlope1(referenceCoordinates=[*point, *direction])) for point in points]
        _beams(system, nodes, beam_section(scene, group), damping_time, gravity)
        ends[link], roots[link] = (nodes[0], nodes[-1]), root
    # motors at the bases, hinges at elbows and end effector
    joints = []
    for leg in (1, 2):
        proximal, distal = ends[f"link{leg}1"], ends[f"link{leg}2"]
        joints.append(_motor(system, roots[f"link{leg}1"], proximal[0], offsets[leg - 1]))
        _hinge(system, proximal[1], distal[0])
    end = ends["link12"][1]
    _hinge(system, end, ends["link22"][1])
    # payload
    if scene.payload.mass:
        _weigh(system, system.AddObject(ObjectMassPoint2D(mass=scene.payload.mass, nodeNumber=end)), gravity)
    # sensors of the end effector's position and acceleration, and of the motors' torques
    kinds, torque = (OutputVariableType.Position, OutputVariableType.Acceleration), OutputVariableType.TorqueLocal
    sensors = [
        *(SensorNode(nodeNumber=end, storeInternal=True, outputVariableType=kind) for kind in kinds),
        *(SensorObject(objectNumber=joint, storeInternal=True, outputVariableType=torque) for joint in joints),
    ]
    mechanism = ExudynMechanism(container, system, [system.AddSensor(sensor) for sensor in sensors])
    system.Assemble()
    return mechanism


def _beams(system: Any, nodes: list[Any], section: BeamSection, damping_time: float, gravity: list[float]) -> None:
    # elements of equal length
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
    """A joint that holds a node at a base and turns its slope to the motor's angle."""
    # joint between ground and node, whose rotation the user function prescribes
    ground = system.AddObject(ObjectGround(referencePosition=[*base, 0.0]))
    markers = [system.AddMarker(MarkerBodyRigid(bodyNumber=ground)), system.AddMarker(MarkerNodeRigid(nodeNumber=node))]
    return system.AddObject(ObjectJointGeneric(markerNumbers=markers, constrainedAxes=CLAMP, offsetUserFunction=offset))


def _hinge(system: Any, *nodes: Any) -> None:
    markers = [system.AddMarker(MarkerNodePosition(nodeNumber=node)) for node in nodes]
    system.AddObject(ObjectJointRevolute2D(markerNumbers=markers))


SPECTRAL_RADIUS = 0.8
"""Of the generalised-alpha method at infinity: damps what is much faster than a step, and keeps second order."""

NEWTON_TOLERANCE = 1e-6
"""Relative tolerance of Newton's method; 1e-8 is below rounding, since links are axially stiff."""


@dataclass(frozen=True)
class ExudynMotion:
    """The robot at N instants.

    Attributes:
        position, acceleration: of the end effector (N, 2) [m, m/s²].
        torque: of the motors (N, 2) [N m].
        time: processor time of the integration, without building the mechanism [s].
    """

    position: RealArray
    acceleration: RealArray
    torque: RealArray
    time: float


def simulate_exudyn(scene: Scene, motion: MotionPlan, instants: RealArray, step: float, elements: int) -> ExudynMotion:
    """Motion under prescribed motor angles, from the static equilibrium at the start.

    Args:
        scene: the robot; damping that isn't proportional to stiffness is left out.
        motion: its planned motion.
        instants: (N,) whole multiples of the step, above zero [s].
        step: of the integrator [s].
        elements: beam elements a link.

    Raises:
        SceneError: the scene has shear, a turning payload or elastic transmissions.
        ValueError: instants are no multiples of the step.
        RunError: Exudyn fails.
    """
    _refuse(scene)
    rows = np.rint(instants / step).astype(int)
    if np.abs(rows * step - instants).max() > 1e-9 * step * rows.max():
        raise ValueError(f"instants must be whole multiples of the step of {step:g} s")
    # the mechanism at the start
    motors = _Motors(motion, step, int(rows[-1]))
    mechanism = exudyn_mechanism(scene, elements, motors.start, [motors.offset(leg) for leg in range(2)])
    settings = _settings(step, int(rows[-1]))
    # static equilibrium, from which the motion starts
    try:
        mechanism.system.SolveStatic(settings)
        rest = mechanism.system.systemData.GetODE2Coordinates()
        mechanism.system.systemData.SetODE2Coordinates(rest, configuration=ConfigurationType.Initial)
        motors.moving = True
        begin = process_time()
        mechanism.system.SolveDynamic(settings)
        time = process_time() - begin
    except SolverError as failure:
        raise RunError(f"Exudyn: {' '.join(str(failure).split())}") from failure
    position, acceleration, *torques = (mechanism.recorded(sensor)[rows] for sensor in mechanism.sensors)
    return ExudynMotion(position[:, :2], acceleration[:, :2], np.stack([t[:, 2] for t in torques], axis=1), time)


class _Motors:
    """Prescribed angles of the joints at the ends of the integrator's steps; those of the start while at rest."""

    def __init__(self, motion: MotionPlan, step: float, count: int) -> None:
        self.start = motion.joints.evaluate(0.0, 0)[0, 0]
        self.moving = False
        self._step, self._angles = step, motion.joints.evaluate(step * np.arange(count + 1), 0)[0].tolist()

    def offset(self, leg: int) -> Offset:
        """The user function of a leg's joint."""

        def function(_system: Any, time: float, _item: int, _parameters: Any) -> list[float]:
            row = round(time / self._step) if self.moving else 0
            return [0.0, 0.0, 0.0, 0.0, 0.0, self._angles[row][leg]]

        return function


def _settings(step: float, count: int) -> Any:
    settings = SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = step
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.newton.relativeTolerance = NEWTON_TOLERANCE
    integration = settings.timeIntegration
    integration.numberOfSteps, integration.endTime = count, count * step
    integration.adaptiveStep = False  # angles are known at the ends of the steps
    integration.newton.relativeTolerance = NEWTON_TOLERANCE
    integration.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
    return settings


def _refuse(scene: Scene) -> None:
    unlike = {
        '`effects.beam` = "timoshenko"': scene.effects.beam == "timoshenko",
        "`payload.inertia`": bool(scene.payload.inertia),
        "`effects.transmission`": scene.effects.transmission is not None,
    }
    for key, there in unlike.items():
        if there:
            raise SceneError(f"Exudyn's planar cable elements have no counterpart of {key}: leave it out of the scene")
