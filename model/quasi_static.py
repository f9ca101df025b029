"""Elastic families that deflect statically: no states, no inertia of their own, but the deflection under the present loads.

The loads on such a family are those that the motion of all others puts on it while it is undeformed; they hold the family's
springs in equilibrium, q = -K^-1 f. The result moves the end effector (and what is measured of the links), not the other
coordinates: this is the static correction of the mode acceleration method. What it leaves out falls with the square of the
motion's frequency over the family's own.

Sources: Craig and Kurdila, Fundamentals of Structural Dynamics (2006), section 11.4; Dickens, Nakagawa and Wittbrodt, A critique
of mode acceleration and modal truncation augmentation methods for modal response analysis, Computers & Structures 62 (1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi

from flexfmu.model.robot import Robot


@dataclass(frozen=True)
class Partition:
    """Indices within q_e (n,) of the coordinates that are states and of those that deflect statically."""

    states: tuple[int, ...]
    statics: tuple[int, ...]

    @staticmethod
    def of(robot: Robot) -> Partition:
        flags = [part.family.quasi_static for _, part in robot.elastic for _ in part.family.shapes]
        flags += [False] * robot.twist.numel()
        indices = range(len(flags))
        return Partition(tuple(i for i in indices if not flags[i]), tuple(i for i in indices if flags[i]))

    def states_of(self, values: casadi.SX) -> casadi.SX:
        """The part (n_states, 1) of values (n, 1) that belongs to states."""
        return values[list(self.states)] if self.statics else values

    def fill(self, states: casadi.SX, statics: casadi.SX | None = None) -> casadi.SX:
        """Values (n, 1) from those of the states and of the others, zero if not given."""
        if not self.statics:
            return states
        values = casadi.SX(len(self.states) + len(self.statics), 1)
        if self.states:
            values[list(self.states)] = states
        if statics is not None:
            values[list(self.statics)] = statics
        return values


def static_deflections(robot: Robot, forces: casadi.SX) -> casadi.SX:
    """Deflections (n_statics, 1) of the quasi-static families for the forces (n, 1) that hold all coordinates."""
    deflections, start = [], 0
    for _, part in robot.elastic:
        stop = start + part.q.numel()
        if part.family.compliance is not None:
            deflections.append(-part.family.compliance @ forces[start:stop])
        start = stop
    return casadi.vertcat(casadi.SX(0, 1), *deflections)
