"""A robot whose references stay as they are over each communication step: stepped by hand, as by a tool without derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.fmu.slave import FmuSlave
from flexfmu.cosim.slave import SlaveVariable
from flexfmu.cosim.workprec.hard.reference import Phase, Solver, signals_of_held
from flexfmu.cosim.workprec.hard.robots import TOLERANCE, fmu_of, paper_robot
from flexfmu.model.assembly import motor_angles

Array = NDArray[np.float64]

SIGNALS = ("end_effector.position.x", "end_effector.position.y", "link11.tip_deflection", "link21.tip_deflection")
"""Outputs that are compared; all lengths [m]."""

REFERENCES = tuple(
    f"joint{leg}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for leg in (1, 2)
)
"""Inputs, in the order of u = [q_a, v_a, a_a]."""

SOLVER = Solver("DOP853", 1e-10)


DAMPING = 0.01
"""Ratio of the links' modal damping: little, so that vibrations last."""


@dataclass(frozen=True)
class HeldRun:
    """The paper's robot, little damped, from links that are straight and at rest.

    Attributes:
        times: (N + 1,) communication points [s]; the first is 0.
        references: (N, 6) u over each step.
    """

    times: Array
    references: Array

    def outputs(self) -> Array:
        """(N, signals) of the FMU at the ends of the steps.

        Raises:
            SlaveError: the FMU fails.
        """
        plant = FmuSlave(fmu_of(paper_robot()), "plant", {"initial": "undeformed", "damping.ratio": DAMPING})
        inputs, outputs = (_indices(plant.variables, names) for names in (REFERENCES, SIGNALS))
        found = np.empty((self.times.size - 1, outputs.size))
        plant.set(inputs, self.references[0])
        try:
            plant.initialize(0.0, float(self.times[-1]), TOLERANCE)
            for n, (begin, end) in enumerate(pairwise(self.times.tolist())):
                plant.set(inputs, self.references[n])
                plant.step(begin, end - begin)
                plant.get(outputs, found[n])
        finally:
            plant.terminate()
        return found

    def reference(self, size: float) -> Array:
        """(N, signals) by SciPy; ``size`` is about how far links deflect [m]."""
        damped = paper_robot().replace({"effects.damping.ratio": DAMPING})
        return signals_of_held(paper_robot(), damped, self._phases(), SIGNALS, self.times[1:], SOLVER, size)

    def _phases(self) -> list[Phase]:
        """Times over which the references stay; each instant belongs to the one that ends there."""
        changes = np.flatnonzero(np.any(np.diff(self.references, axis=0) != 0.0, axis=1)) + 1
        edges = [0, *changes.tolist(), self.times.size - 1]
        return [Phase(float(self.times[a]), float(self.times[b]), self.references[a]) for a, b in pairwise(edges)]


def start_references() -> Array:
    """u (6,) of the paper's start pose, locked."""
    robot = paper_robot()
    return np.concatenate([motor_angles(robot.mechanism, robot.trajectory.start), np.zeros(4)])


def _indices(variables: Sequence[SlaveVariable], names: Sequence[str]) -> NDArray[np.intp]:
    known = [variable.name for variable in variables]
    return np.array([known.index(name) for name in names], dtype=np.intp)
