"""Natural frequencies of the flexible robot with locked motors, about its static equilibrium."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from flexfmu.model.errors import EquilibriumError
from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.scene import Scene
from flexfmu.model.statics import static_equilibrium

Array = NDArray[np.float64]


def natural_frequencies(scene: Scene, joints: tuple[float, float] | Array) -> Array:
    """Undamped natural frequencies [Hz], ascending, shape (n,), with the motors locked at (q11, q21) [rad].

    Raises:
        EquilibriumError: there is no static equilibrium at the pose, or it is unstable (buckled).
    """
    model, u = numeric_model(scene), standstill(joints)
    if model.n == 0:
        return np.empty(0)
    elastic = static_equilibrium(scene, joints).elastic
    stiffness = model.static_stiffness(elastic, u).full()
    mass = model.mass_matrix(elastic, u).full()
    squares = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T), eigvals_only=True)
    if squares[0] < 0.0:
        raise EquilibriumError(
            f"the static equilibrium with the motors at q11 = {u[0]:.6g} rad, q21 = {u[1]:.6g} rad is unstable "
            f"(lowest eigenvalue {squares[0]:.4g} 1/s2): the load buckles the robot near this pose"
        )
    return np.asarray(np.sqrt(squares) / (2 * np.pi), dtype=float)
