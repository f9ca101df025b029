"""State feedback with an observer: separation, tracking, limits."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from blocks import linear_system, lqg, sampled
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers import state_feedback as state_feedbacks
from flexfmu.cosim.control.controllers.from_control import LinearSystem, from_control
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]

H = 1e-3
CONTROL_POLES, OBSERVER_POLES = [0.9, 0.92, 0.85, 0.8], [0.5, 0.55, 0.6, 0.65]


def two_masses() -> LinearSystem:
    """Two masses on a spring: torque on the first, its angle measured; sampled exactly at 1 kHz."""
    k, m1, m2 = 400.0, 0.5, 0.2
    A = [[0, 1, 0, 0], [-k / m1, 0, k / m1, 0], [0, 0, 0, 1], [k / m2, 0, -k / m2, 0]]
    system = control.ss(A, [[0], [1 / m1], [0], [0]], [[1, 0, 0, 0]], [[0]], inputs=["torque"], outputs=["angle"])
    return from_control(system.sample(H))


def gains(plant: LinearSystem) -> tuple[Array, Array]:
    """K and L that place the poles."""
    K = control.place(plant.A, plant.B, CONTROL_POLES)
    L = control.place(plant.A.T, plant.C.T, OBSERVER_POLES).T
    return np.asarray(K), np.asarray(L)


def close(
    plant: LinearSystem,
    block: SymbolicBlock,
    start: Array,
    inputs: dict[str, float],
    count: int,
    base: Any = (0.0, 0.0),
) -> tuple[Array, Array, Array]:
    """States (N, n) of the plant, estimates (N, n) and inputs (N, m) of a closed loop; ``base`` is (u_0, y_0)."""
    slave = BlockSlave(block)
    names = [variable.name for variable in slave.variables]
    measured = np.array([names.index(signal.name) for signal in plant.outputs])
    output = np.array([names.index(signal.name) for signal in plant.inputs])
    slave.set(np.array([names.index(name) for name in inputs], dtype=np.intp), np.array(list(inputs.values())))
    slave.initialize(0.0, 1.0, None)
    x, u = start.copy(), np.empty(output.size)
    states, estimates, actions = [], [], []
    for k in range(count):
        states.append(x)
        estimates.append(slave.save()[-2 * plant.order : -plant.order])
        slave.set(measured, plant.C @ x + base[1])
        slave.sample(k * H)
        slave.get(output, u)
        actions.append(u.copy())
        x = plant.A @ x + plant.B @ (u - base[0])
    return np.array(states), np.array(estimates), np.array(actions)


@pytest.mark.parametrize("limits", [None, 1.0])
def test_observer_error_decays_with_its_poles(limits: float | None) -> None:
    """The estimate's error is (A - L C)^k e_0, whatever the controller does; the observer knows the limited input, too."""
    plant = two_masses()
    K, L = gains(plant)
    start = np.array([0.1, -1.0, 0.2, 3.0])
    states, estimates, actions = close(plant, state_feedbacks.state_feedback(plant, K, L, limits=limits), start, {}, 40)
    assert limits is None or (actions.min(), actions.max()) == (-1.0, 1.0)
    closed = plant.A - L @ plant.C
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(closed).real), OBSERVER_POLES, rtol=1e-6)
    wanted = np.array([np.linalg.matrix_power(closed, k) @ start for k in range(40)])
    np.testing.assert_allclose(states - estimates, wanted, rtol=0, atol=1e-12 * abs(wanted).max())


def test_separation() -> None:
    """With a right estimate from the start the plant moves by (A - B K)^k x_0: its poles are those placed."""
    plant = two_masses()
    K, L = gains(plant)
    start = np.array([0.1, -1.0, 0.2, 3.0])
    states, _, _ = close(plant, state_feedbacks.state_feedback(plant, K, L, estimate=list(start)), start, {}, 200)
    wanted = np.array([np.linalg.matrix_power(plant.A - plant.B @ K, k) @ start for k in range(200)])
    np.testing.assert_allclose(states, wanted, rtol=0, atol=1e-10 * abs(wanted).max())


def test_tracks_without_static_error() -> None:
    """The feedforward brings the angle to its reference and the torque to what holds it, about the equilibrium."""
    plant = two_masses()
    K, L = gains(plant)
    equilibrium = state_feedbacks.Equilibrium(inputs=[5.0], outputs=[1.2])
    reference = state_feedbacks.static_feedforward(plant, ["angle"], equilibrium)
    block = state_feedbacks.state_feedback(plant, K, L, reference=reference, equilibrium=equilibrium)
    assert [variable.name for variable in block.inputs] == ["angle", "reference.angle"]
    assert block.feedthrough == {"torque": ("reference.angle",)}
    states, _, actions = close(plant, block, np.zeros(4), {"reference.angle": 1.5}, 400, base=(5.0, 1.2))
    np.testing.assert_allclose(states[-1], [0.3, 0.0, 0.3, 0.0], atol=1e-8)
    np.testing.assert_allclose(actions[-1], 5.0, atol=1e-6)


def test_multivariable_with_feedthrough() -> None:
    """Two inputs, three outputs and D: the estimate converges as designed, and the estimator's D term counts."""
    rng = np.random.default_rng(8)
    A = rng.normal(size=(3, 3))
    A *= 1.02 / abs(np.linalg.eigvals(A)).max()
    B, C, D = rng.normal(size=(3, 2)), rng.normal(size=(3, 3)), np.zeros((3, 2))
    D[2, 1] = 0.7
    plant = linear_system(A, B, C, D, H)
    K, _, _ = control.dlqr(A, B, np.eye(3), np.eye(2))
    L, _, _ = control.dlqe(A, np.eye(3), C, np.eye(3), np.eye(3))
    slave = BlockSlave(state_feedbacks.state_feedback(plant, K, L))
    x, u = rng.normal(size=3), np.empty(2)
    error = x.copy()
    slave.initialize(0.0, 1.0, None)
    for k in range(50):
        estimate = slave.save()[-6:-3]
        np.testing.assert_allclose(x - estimate, error, rtol=0, atol=1e-12)
        u = -np.asarray(K) @ estimate
        slave.set(np.arange(3), C @ x + D @ u)
        slave.sample(k * H)
        found = np.empty(2)
        slave.get(np.array([3, 4]), found)
        np.testing.assert_allclose(found, u, rtol=1e-12, atol=1e-12)
        x, error = A @ x + B @ u, (A - np.asarray(L) @ C) @ error
    assert abs(x).max() < 1e-3


@pytest.mark.parametrize(("change", "message"), [
    ({"K": np.zeros((4, 1))}, "state_feedback: K must be 1 x 4, got 4 x 1"),
    ({"L": np.zeros((1, 4))}, "state_feedback: L must be 4 x 1, got 1 x 4"),
    ({"K": [[1.0, np.nan, 0.0, 0.0]]}, r"K\[0, 1\] must be finite, got nan"),
    ({"K": 3.0}, "K must be 1 x 4, got a number"),
    ({"estimate": [1.0]}, "state_feedback: estimate must be 4 x 1, got 1 x 1"),
    ({"equilibrium": state_feedbacks.Equilibrium([1.0, 2.0], [0.0])}, "equilibrium.inputs must be 1 x 1, got 2 x 1"),
    ({"limits": -1.0}, "limits must be positive and finite, got -1.0"),
    ({"offset": -1.0}, "the offset must be zero or positive"),
    ({"reference": state_feedbacks.ReferenceFeedforward((), np.zeros((3, 0)), np.zeros((1, 0)))}, "Nx must be 4 x 0, got 3 x 0"),
])  # fmt: skip
def test_refused(change: dict[str, Any], message: str) -> None:
    """Gains of the wrong shape are the commonest mistake; the message says which shape is right."""
    plant = two_masses()
    K, L = gains(plant)
    with pytest.raises(InputError, match=message):
        state_feedbacks.state_feedback(plant, **({"K": K, "L": L} | change))


@pytest.mark.parametrize(("plant", "tracked", "message"), [
    (two_masses(), ["position"], "the plant has no output 'position'; choose from angle"),
    (two_masses(), [], "1 inputs can track as many outputs, got 0"),
    # a plant that differentiates can't hold an output at rest
    (linear_system([[0.5]], [[1.0]], [[0.5]], [[-1.0]], H), ["y[0]"], "can't be set independently at rest"),
])  # fmt: skip
def test_refused_tracking(plant: LinearSystem, tracked: list[str], message: str) -> None:
    """As many outputs as inputs, by name, which rest independently."""
    with pytest.raises(InputError, match=message):
        state_feedbacks.static_feedforward(plant, tracked)


def test_only_ratios_of_lqg_weights_count() -> None:
    """Twice all costs, or twice all standard deviations, is the same controller; other ratios are another one."""
    scene = load_scene("barnard2012-6kg").replace({"effects.proximal_bending": 1, "effects.distal_axial": 0})
    costs = {"position_error": 2e-3, "velocity_error": 0.2, "torque_deviation": 20.0}
    twice = {**costs, "torque_noise": 3.0, "measurement_noise": 3e-5}
    found = []
    for keys in ({}, twice, {"torque_noise": 3.0}):
        block = lqg(scene=scene, sample_time=H, **keys)
        # a measured angle has jumped by a milliradian
        u = [(each.start or 0.0) + 1e-3 * (each.name == "joint1.position") for each in block.inputs]
        found.append(sampled(block, np.tile(u, (50, 1))))
    one, same, another = found
    np.testing.assert_allclose(same, one, rtol=1e-6, atol=1e-9 * abs(one).max())
    assert abs(another - one).max() > 1e-3 * abs(one).max()
