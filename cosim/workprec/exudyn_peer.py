"""The same mechanism in Exudyn: planar ANCF cable elements, algebraic joints, generalised-alpha with a fixed step.

Its beams are Euler and Bernoulli's, in absolute coordinates, so that foreshortening is in them; they have no shear. Damping
proportional to stiffness is the same as here, modal damping isn't there.

Sources: Gerstmayr, Exudyn: a C++ based Python package for flexible multibody systems, Multibody Syst. Dyn. (2023); Gerstmayr
and Irschik, On the correct representation of bending and axial deformation in the absolute nodal coordinate formulation with
an elastic line approach, J. Sound Vib. 318 (2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from exudyn import ConfigurationType, SimulationSettings, SolverError
from numpy.typing import NDArray

from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.workprec.exudyn_mechanism import Offset, exudyn_mechanism
from flexfmu.cosim.workprec.subject import RunError
from flexfmu.model.errors import SceneError
from flexfmu.model.scene import Scene

Array = NDArray[np.float64]

SPECTRAL_RADIUS = 0.8
"""Of the generalised-alpha method at infinity: damps what is much faster than a step, and keeps second order."""

NEWTON_TOLERANCE = 1e-6
"""Of residuals; 1e-8 is below their rounding, since links are stiff along their axis."""


@dataclass(frozen=True)
class ExudynMotion:
    """The robot at N instants.

    Attributes:
        position, acceleration: of the end effector (N, 2) [m, m/s²].
        torque: of the motors (N, 2) [N m].
        time: processor time of the integration, without building the mechanism [s].
    """

    position: Array
    acceleration: Array
    torque: Array
    time: float


def run_exudyn(scene: Scene, motion: MotionPlan, instants: Array, step: float, elements: int) -> tuple[Array, float]:
    """Positions (N, 2) [m] of the end effector and processor time [s]; see `simulate_exudyn`."""
    run = simulate_exudyn(scene, motion, instants, step, elements)
    return run.position, run.time


def simulate_exudyn(scene: Scene, motion: MotionPlan, instants: Array, step: float, elements: int) -> ExudynMotion:
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
        RunError: Exudyn gives up.
    """
    _refuse(scene)
    rows = np.rint(instants / step).astype(int)
    if np.abs(rows * step - instants).max() > 1e-9 * step * rows.max():
        raise ValueError(f"instants must be whole multiples of the step of {step:g} s")
    motors = _Motors(motion, step, int(rows[-1]))
    mechanism = exudyn_mechanism(scene, elements, motors.start, [motors.offset(leg) for leg in range(2)])
    settings = _settings(step, int(rows[-1]))
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
    """Angles that the joints ask for at the ends of the integrator's steps; those of the start while at rest."""

    def __init__(self, motion: MotionPlan, step: float, count: int) -> None:
        self.start = motion.joints.evaluate(0.0, 0)[0, 0]
        self.moving = False
        self._step, self._angles = step, motion.joints.evaluate(step * np.arange(count + 1), 0)[0].tolist()

    def offset(self, leg: int) -> Offset:
        """What the joint of a leg asks for."""

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
