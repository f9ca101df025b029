"""A robot along its planned motion: matrices of small elastic motions at every instant, and its exact nonlinear outputs.

The matrices are Jacobians of the elastic forces about the undeformed robot that follows the planned joint motion; with
them the response to the loads of that motion is linear, M(t) q'' + C(t) q' + K(t) q = f(t).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi
import numpy as np
from scipy.interpolate import interp1d

from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene.effects import Effects
from flexfmu.model.scene.schema import Scene
from flexfmu.model.selection.motion_grid import MotionGrid
from flexfmu.model.selection.response import LinearTimeVaryingSystem, Response
from flexfmu.trajectories.jets import Indices, RealArray

MATRICES_EVERY = 8
"""Instants from one evaluation of the matrices to the next; they follow the pose, which changes slowly."""

NEWTON_STEPS = 3
"""Steps to a static equilibrium: small deflections need no more, see `flexfmu.model.statics`."""


_NAME = re.compile(r"link(?P<leg>\d)(?P<link>\d)\.(?P<direction>\w+)\[(?P<mode>\d+)\]")
"""A coordinate of a link, like ``link11.bending[1]``."""


@dataclass(frozen=True, eq=False)
class Outputs:
    """Outputs of a robot at N instants: end effector [m, m/s, m/s²] and torques [N m], each (N, 2)."""

    position: RealArray
    velocity: RealArray
    acceleration: RealArray
    torque: RealArray


class LinearizedMotion:
    """The robot of a scene along a motion.

    Args:
        scene: with all effects that are compared.
        grid: instants of the motion.

    Attributes:
        names: of all coordinates.
    """

    def __init__(self, scene: Scene, grid: MotionGrid) -> None:
        self._model = numeric_model(scene)
        self.names, self._joints = self._model.names, grid.joints.T
        self._scene, self._grid = scene, grid

    @cached_property
    def linear(self) -> LinearTimeVaryingSystem:
        """Matrices of small motions about the undeformed robot: evaluated at every few instants, straight lines between."""
        grid = self._grid
        # some instants of each span, both ends included
        every = [np.linspace(a, b - 1, (b - a) // MATRICES_EVERY + 2).round().astype(np.intp) for a, b in grid.spans]
        coarse = np.concatenate([np.unique(some) for some in every])
        count, n = coarse.size, self._model.n
        found = _full(_matrices(self._scene).map(count)(grid.joints[coarse].T))
        matrices = [matrix.reshape(n, count, n).transpose(1, 0, 2) for matrix in found]
        # instants at jumps are different ones at the same time, so that the index is what is interpolated along
        between = interp1d(coarse, np.stack(matrices), axis=1)(np.arange(grid.time.size))
        return LinearTimeVaryingSystem(between[0], between[1], between[2], grid.spans, grid.steps)

    @cached_property
    def load(self) -> RealArray:
        """Forces on the undeformed robot (N, n)."""
        rest = np.zeros((self._grid.time.size, self._model.n))
        return -self.forces(Response(rest, rest, rest))

    def coordinates(self, effects: Effects, *, static: bool = False) -> Indices:
        """Indices of the coordinates that are states with such effects, or of those that deflect statically.

        What belongs to no link (twists of the transmissions) isn't chosen and always a state.
        """
        found = []
        for i, name in enumerate(self._model.names):
            match = _NAME.fullmatch(name)
            if match is None:
                belongs = not static
            else:
                family = f"{'proximal' if match['link'] == '1' else 'distal'}_{match['direction']}"
                has_mode = int(match["mode"]) <= getattr(effects, family)
                belongs = has_mode and (family in effects.quasi_static) is static
            found += [i] if belongs else []
        return np.array(found, dtype=np.intp)

    def response(self, states: Indices, start: RealArray) -> Response:
        """Elastic motion in linear approximation (N, n), with `states` alone moving, from rest at `start`."""
        return self._respond(states, self.load, start)

    def corrected(self, motion: Response, states: Indices) -> Response:
        """A motion with the linear response to the forces that it leaves unbalanced, from its own start."""
        return motion + self._respond(states, -self.forces(motion), np.zeros(states.size))

    def _respond(self, states: Indices, load: RealArray, start: RealArray) -> Response:
        part = self.linear.restricted(states).response(load[:, states], start)
        return Response(*(self._spread(values, states) for values in (part.position, part.velocity, part.acceleration)))

    def deflections(self, motion: Response, statics: Indices) -> RealArray:
        """Quasi-static deflections (N, n) of some coordinates under the forces that the motion of the others exerts on them."""
        force = self.forces(motion)[:, statics]
        stiffness = self.linear.stiffness[np.ix_(np.arange(len(force)), statics, statics)]
        return self._spread(
            -np.asarray(np.linalg.solve(stiffness, force[..., None]), dtype=np.float64)[..., 0], statics
        )

    def equilibrium(self, rest: RealArray, states: Indices) -> RealArray:
        """Static deflection of some coordinates (m,) at a standstill u = [q_a, 0, 0]."""
        return self._static(rest, np.zeros(self._model.n), states)[states]

    def rest_position(self, rest: RealArray, states: Indices, statics: Indices) -> RealArray:
        """End effector in the static equilibrium at a standstill (2,) [m]."""
        # the states first, without the others; then what deflects statically under their forces
        zeros = np.zeros(self._model.n)
        q = self._static(rest, self._static(rest, zeros, states), statics)
        return np.asarray(self._model.motion(q, zeros, zeros, rest)[0].full()).ravel()

    def _static(self, rest: RealArray, q: RealArray, free: Indices) -> RealArray:
        """Deflections (n,) with some coordinates in equilibrium and the others as they are in `q`."""
        found, zeros = q.copy(), np.zeros(self._model.n)
        for _ in range(NEWTON_STEPS if free.size else 0):
            stiffness = self._model.static_stiffness(found, rest).full()[np.ix_(free, free)]
            force = self._model.elastic_forces(found, zeros, zeros, rest).full().ravel()[free]
            found[free] -= np.linalg.solve(stiffness, force)
        return found

    def _spread(self, values: RealArray, at: Indices) -> RealArray:
        """Values (N, m) of some coordinates among zeros (N, n)."""
        result = np.zeros((values.shape[0], self._model.n))
        result[:, at] = values
        return result

    def forces(self, motion: Response) -> RealArray:
        """Forces that all coordinates need for a motion (N, n)."""
        function = self._model.elastic_forces.map(motion.position.shape[0])
        arguments = motion.position.T, motion.velocity.T, motion.acceleration.T, self._joints
        return _full([function(*arguments)])[0].T

    def hardening(self, motion: Response) -> RealArray:
        """Forces of bending beyond linear theory (N, n), which no set of effects contains."""
        function = self._model.hardening.map(motion.position.shape[0])
        return _full([function(motion.position.T)])[0].T

    def outputs(self, motion: Response) -> Outputs:
        """End effector and torques of a motion."""
        function = self._model.motion.map(motion.position.shape[0])
        arguments = motion.position.T, motion.velocity.T, motion.acceleration.T, self._joints
        return Outputs(*(result.T for result in _full(function(*arguments))))


def _full(results: Iterable[casadi.DM]) -> list[RealArray]:
    """CasADi's matrices as arrays."""
    return [np.asarray(result.full()) for result in results]


@lru_cache(maxsize=16)
def _matrices(scene: Scene) -> casadi.Function:
    """u → mass, damping and stiffness matrix of small motions about the undeformed robot, (n, n) each."""
    model = numeric_model(scene)
    q, v, a = (casadi.SX.sym(name, model.n) for name in "qva")
    u = casadi.SX.sym("u", 6)
    force = model.elastic_forces(q, v, a, u)
    state, rest = casadi.vertcat(q, v, a), casadi.SX.zeros(3 * model.n)
    results = [casadi.substitute(casadi.jacobian(force, x), state, rest) for x in (a, v, q)]
    dense = [casadi.densify(result) for result in casadi.cse(results)]
    return casadi.Function("matrices", [u], dense)
