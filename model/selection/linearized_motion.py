"""A robot along its planned motion: matrices of small elastic motions at every instant, and nonlinear outputs.

The matrices are Jacobians of the elastic forces about the undeformed robot in its planned motion. The response to the
loads of that motion is then linear, M(t) q'' + C(t) q' + K(t) q = f(t).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi
import numpy as np

from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene.effects import Effects
from flexfmu.model.scene.schema import Scene
from flexfmu.model.selection.response import ElasticMotion, LinearTimeVaryingSystem, MotionGrid
from flexfmu.model.vectorised import Vectorised
from flexfmu.trajectories.jets import Indices, RealArray

MATRICES_EVERY = 8
"""Number of instants between evaluations of the matrices; they depend on the pose, which changes slowly."""

NEWTON_STEPS = 3
"""Newton steps to a static equilibrium: enough for small deflections, see `flexfmu.model.statics`."""


_NAME = re.compile(r"link(?P<leg>\d)(?P<link>\d)\.(?P<direction>\w+)\[(?P<mode>\d+)\]")
"""Name of a modal coordinate, like ``link11.bending[1]``."""


@dataclass(frozen=True, eq=False)
class Outputs:
    """Outputs of a robot at N instants: end effector [m, m/s, m/s²] and torques [N m], each (N, 2)."""

    position: RealArray
    velocity: RealArray
    acceleration: RealArray
    torque: RealArray


class LinearizedMotion:
    """The robot of a scene, linearised along a motion.

    Args:
        scene: scene with all effects to compare.
        grid: instants of the motion.

    Attributes:
        names: names of all elastic coordinates.
    """

    def __init__(self, scene: Scene, grid: MotionGrid) -> None:
        self._model = numeric_model(scene)
        self.names, self._scene, self._grid = self._model.names, scene, grid

    @cached_property
    def linear(self) -> LinearTimeVaryingSystem:
        """Matrices of small motions about the undeformed robot, interpolated linearly between a subset of instants."""
        grid = self._grid
        # some instants of each span, both ends included
        every = [np.linspace(a, b - 1, (b - a) // MATRICES_EVERY + 2).round().astype(np.intp) for a, b in grid.spans]
        coarse = np.concatenate([np.unique(some) for some in every])
        count, n = coarse.size, self._model.n
        matrices = [
            matrix.reshape(count, n, n).transpose(0, 2, 1) for matrix in _matrices(self._scene)([grid.joints[coarse]])
        ]
        # interpolate over the index: a jump is two instants at the same time
        between = _interpolated(coarse, np.stack(matrices, axis=1), np.arange(grid.time.size))
        mass, damping, stiffness = (np.ascontiguousarray(between[:, i]) for i in range(3))
        return LinearTimeVaryingSystem(mass, damping, stiffness, grid.spans, grid.steps)

    @cached_property
    def load(self) -> RealArray:
        """Forces on the undeformed robot (N, n)."""
        rest = np.zeros((self._grid.time.size, self._model.n))
        return -self.forces(ElasticMotion(rest, rest, rest))

    def coordinates(self, effects: Effects, *, static: bool = False) -> Indices:
        """Indices of the coordinates that are states with these effects; with `static`, of the quasi-static ones.

        Twists of the transmissions belong to no link; they are always states.
        """
        found = []
        # the family of the coordinate must have this mode, as a state or quasi-statically
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

    def response(self, states: Indices, start: RealArray) -> ElasticMotion:
        """Linear response (N, n) of the coordinates `states`, from rest at `start`; all others stay zero."""
        return self._respond(states, self.load, start)

    def corrected(self, motion: ElasticMotion, states: Indices) -> ElasticMotion:
        """The motion plus the linear response of `states` to its residual forces."""
        return motion + self._respond(states, -self.forces(motion), np.zeros(states.size))

    def _respond(self, states: Indices, load: RealArray, start: RealArray) -> ElasticMotion:
        part = self.linear.restricted(states).response(load[:, states], start)
        return ElasticMotion(
            *(self._spread(values, states) for values in (part.position, part.velocity, part.acceleration))
        )

    def deflections(self, motion: ElasticMotion, statics: Indices) -> RealArray:
        """Quasi-static deflections (N, n) of the coordinates `statics` under the forces of a motion."""
        force = self.forces(motion)[:, statics]
        stiffness = self.linear.stiffness[np.ix_(np.arange(len(force)), statics, statics)]
        return self._spread(
            -np.asarray(np.linalg.solve(stiffness, force[..., None]), dtype=np.float64)[..., 0], statics
        )

    def equilibrium(self, rest: RealArray, states: Indices) -> RealArray:
        """Static deflections (m,) of the coordinates `states` at a standstill u = [q_a, 0, 0]."""
        return self._static(rest, np.zeros(self._model.n), states)[states]

    def rest_position(self, rest: RealArray, states: Indices, statics: Indices) -> RealArray:
        """End-effector position (2,) [m] in the static equilibrium at a standstill."""
        # first the states alone, then the static deflections under their forces
        zeros = np.zeros(self._model.n)
        q = self._static(rest, self._static(rest, zeros, states), statics)
        return np.asarray(self._model.motion(q, zeros, zeros, rest)[0].full()).ravel()

    def _static(self, rest: RealArray, q: RealArray, free: Indices) -> RealArray:
        """Deflections (n,) with the coordinates `free` in equilibrium and all others as in `q`."""
        found, zeros = q.copy(), np.zeros(self._model.n)
        for _ in range(NEWTON_STEPS if free.size else 0):
            stiffness = self._model.static_stiffness(found, rest).full()[np.ix_(free, free)]
            force = self._model.elastic_forces(found, zeros, zeros, rest).full().ravel()[free]
            found[free] -= np.linalg.solve(stiffness, force)
        return found

    def _spread(self, values: RealArray, at: Indices) -> RealArray:
        """Values (N, n): those of the coordinates `at` (N, m), zero elsewhere."""
        result = np.zeros((values.shape[0], self._model.n))
        result[:, at] = values
        return result

    def forces(self, motion: ElasticMotion) -> RealArray:
        """Forces on all elastic coordinates that a motion needs (N, n)."""
        function = _vectorised(self._scene, "elastic_forces")
        return function([motion.position, motion.velocity, motion.acceleration, self._grid.joints])[0]

    def outputs(self, motion: ElasticMotion) -> Outputs:
        """End-effector motion and motor torques of a motion."""
        function = _vectorised(self._scene, "motion")
        return Outputs(*function([motion.position, motion.velocity, motion.acceleration, self._grid.joints]))


def _interpolated(knots: Indices, values: RealArray, at: Indices) -> RealArray:
    """Values (N, ...) at indices (N,), linear between those (K, ...) at ascending knots (K,)."""
    upper = np.clip(np.searchsorted(knots, at), 1, len(knots) - 1)
    lower, shape = upper - 1, (-1,) + (1,) * (values.ndim - 1)
    slope = (values[upper] - values[lower]) / (knots[upper] - knots[lower]).reshape(shape)
    return np.asarray(slope * (at - knots[lower]).reshape(shape) + values[lower])


@lru_cache(maxsize=32)
def _vectorised(scene: Scene, name: str) -> Vectorised:
    """A function of the scene's model, for all instants at once."""
    return Vectorised(getattr(numeric_model(scene), name))


@lru_cache(maxsize=16)
def _matrices(scene: Scene) -> Vectorised:
    """u → mass, damping and stiffness matrix of small motions about the undeformed robot, n² values each, column by column."""
    model = numeric_model(scene)
    q, v, a = (casadi.SX.sym(name, model.n) for name in "qva")
    u = casadi.SX.sym("u", 6)
    force = model.elastic_forces(q, v, a, u)
    state, rest = casadi.vertcat(q, v, a), casadi.SX.zeros(3 * model.n)
    results = [casadi.substitute(casadi.jacobian(force, x), state, rest) for x in (a, v, q)]
    dense = [casadi.densify(result) for result in casadi.cse(results)]
    return Vectorised(casadi.Function("matrices", [u], dense))
