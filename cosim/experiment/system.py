"""The slaves of a scene (planned motion, robot, controllers, shapers, imperfections), their connections and coupling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value, parameter_names
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.engine.master.iteration import Anderson, FixedPoint, LoopSolver, Tolerance
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.engine.trajectory_slave import HERMITE_ORDER, TrajectorySlave
from flexfmu.cosim.experiment.parameters import holding_torques, parameters_for
from flexfmu.cosim.experiment.scene_loop import Loop
from flexfmu.cosim.experiment.wiring import Wiring, names_of, wire
from flexfmu.fmu_build.choices import FIXED_STEP, INITIAL, INTEGRATOR
from flexfmu.model.scene import cosimulation as sections
from flexfmu.model.scene.schema import Scene

TORQUES = ("joint1.torque", "joint2.torque")

PLANT, REFERENCES = "plant", "trajectory"
"""Names of the slaves for the robot and for the planned motion."""


@dataclass(frozen=True)
class SceneSystem:
    """The slaves of a scene with their connections.

    Attributes:
        references: slave that outputs the planned motion.
        plant: the robot.
        others: controllers, shapers, imperfections and disturbances.
        wiring: connections between the slaves.
        changes: parameters of the robot that differ from those of the scene.
        unfed: values of the robot's inputs if they are not connected.
    """

    references: TrajectorySlave
    plant: FmuSlave
    others: tuple[Slave, ...]
    wiring: Wiring
    changes: Mapping[str, float]
    unfed: Mapping[str, float]

    @property
    def slaves(self) -> tuple[Slave, ...]:
        """All slaves: planned motion, robot, then the others."""
        return (self.references, self.plant, *self.others)

    @property
    def constants(self) -> Mapping[str, float]:
        """Unconnected inputs of the robot with their constant values."""
        feeding = self.wiring.feeding
        return {name: self.changes.get(name, value) for name, value in self.unfed.items() if name not in feeding}

    def with_parameters(self, parameters: Mapping[str, float]) -> SceneSystem:
        """The system with further changed parameters of the robot; the shared robot uses them in its next run.

        Raises:
            InputError: a parameter doesn't exist or is out of range.
        """
        changes = {**self.changes, **parameters}
        self.plant.vary(changes)
        return replace(self, changes=changes)


def scene_system(
    scene: Scene,
    loop: Loop,
    fmu_path: Path,
    *,
    parameters: Mapping[str, float] | None = None,
    initial: str | None = None,
    input_order: int | None = None,
) -> SceneSystem:
    """Load the robot's FMU and connect it with the motion, controllers, shapers and imperfections.

    Args:
        scene: the scene.
        loop: planned motion, controllers, shapers and imperfections.
        fmu_path: FMU of the robot.
        parameters: FMU parameters that differ from the scene's.
        initial: ``static`` or ``undeformed``; None for the scene's value.
        input_order: degree of the input polynomials; None for the highest that the FMU supports.

    Raises:
        InputError: an FMU can't be loaded or lacks a variable, a parameter doesn't exist or is out of range, or the
            slaves can't be connected.
    """
    # parameters of the FMU from the scene: physical ones, initial state, integrator
    section, available = scene.cosimulation, parameter_names(open_fmu(fmu_path).description)
    settings: dict[str, Value] = {**parameters_for(scene, available), INITIAL.name: initial or section.initial}
    if section.integrator != "automatic":
        settings[INTEGRATOR.name] = section.integrator
    if section.integrator_step > 0.0:
        settings[FIXED_STEP] = section.integrator_step
    if loop.motion.design is not None:
        # the flexible end effector is at the start of the path, the rigid one isn't
        settings |= dict(zip(("start.x", "start.y"), loop.motion.start, strict=True))
    # motors without a controller: constant torques hold the start pose; explicit connections may be from any name
    acting = (*loop.controllers, *(inline.slave for inline in loop.inline_blocks))
    given = {name.replace("_", ".") for slave in acting for name in names_of(slave, "output")}
    unfed = {} if given >= {*TORQUES} else holding_torques(scene)
    settings |= unfed
    # the slaves and their connections
    plant = FmuSlave(fmu_path, PLANT, settings, input_order)
    order = min(plant.max_input_order, HERMITE_ORDER) if input_order is None else input_order
    references = TrajectorySlave(loop.driving, order=order, name=REFERENCES)
    others = (*acting, *loop.disturbances)
    wiring = wire(references, plant, loop.controllers, loop.inline_blocks, loop.connect, loop.disturbances)
    parts = SceneSystem(references, plant, others, wiring, loop.parameters, unfed)
    return parts.with_parameters(parameters or {})


@dataclass(frozen=True)
class CouplingMethod:
    """Co-simulation algorithm of a scene.

    Attributes:
        algorithm: coupling of the slaves over a communication step.
        loops: solver of algebraic loops; None refuses them.
        step_control: control of the communication step size; None for a constant step.
    """

    algorithm: Algorithm
    loops: LoopSolver | None
    step_control: StepDoubling | None


def coupling_of(section: sections.Cosimulation) -> CouplingMethod:
    """The co-simulation algorithm of a scene's section."""
    solver: LoopSolver | None = None
    if (given := section.loop_solver) is not None:
        tolerance, rounds = Tolerance(relative=given.tolerance), given.iterations
        if isinstance(given, sections.FixedPointSection):
            solver = FixedPoint(given.relaxation, tolerance=tolerance, rounds=rounds)
        else:
            solver = Anderson(tolerance=tolerance, rounds=rounds)
    # implicit coupling has a default solver
    implicit = Implicit() if solver is None else Implicit(solver)
    algorithms: dict[str, Algorithm] = {"jacobi": Jacobi(), "gauss-seidel": GaussSeidel(), "implicit": implicit}
    control, doubling = section.step_control, None
    if control is not None:
        largest = inf if control.maximum is None else control.maximum
        doubling = StepDoubling(control.tolerance, smallest=control.minimum, largest=largest)
    return CouplingMethod(algorithms[section.algorithm], solver, doubling)
