"""How a scene's slaves are coupled: from `[cosimulation]` to the master's algorithm, solver and step control."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from flexfmu.cosim.master.algorithms import Algorithm, GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.master.iteration import Anderson, FixedPoint, LoopSolver, Tolerance
from flexfmu.cosim.master.step_control import StepDoubling
from flexfmu.model import cosimulation_section as sections


@dataclass(frozen=True)
class Coupling:
    """What the master is told.

    Attributes:
        algorithm: how slaves are coupled over a step.
        loops: how algebraic loops are solved; None refuses them.
        step_control: chooses the communication steps; None for a constant step.
    """

    algorithm: Algorithm
    loops: LoopSolver | None
    step_control: StepDoubling | None


def coupling_of(section: sections.Cosimulation) -> Coupling:
    """The coupling that a scene asks for."""
    solver = None if section.loop_solver is None else _solver(section.loop_solver)
    return Coupling(_algorithm(section.algorithm, solver), solver, _step_control(section.step_control))


def _algorithm(name: str, solver: LoopSolver | None) -> Algorithm:
    if name == "jacobi":
        return Jacobi()
    if name == "implicit":
        return Implicit() if solver is None else Implicit(solver)
    return GaussSeidel()


def _solver(section: sections.FixedPoint | sections.Anderson) -> LoopSolver:
    tolerance = Tolerance(relative=section.tolerance)
    if isinstance(section, sections.FixedPoint):
        return FixedPoint(section.relaxation, tolerance, section.iterations)
    return Anderson(tolerance=tolerance, rounds=section.iterations)


def _step_control(section: sections.StepControl | None) -> StepDoubling | None:
    if section is None:
        return None
    largest = inf if section.maximum is None else section.maximum
    return StepDoubling(section.tolerance, smallest=section.minimum, largest=largest)
