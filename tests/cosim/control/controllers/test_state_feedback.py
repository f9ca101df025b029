"""State feedback with an observer: separation, tracking, limits; H-infinity loop shaping: gamma of known plants, norms of the sampled loop, the
block against a recursion in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi, sqrt
from typing import Any

import control
import numpy as np
import pytest
from blocks import h_infinity, linear_system, lqg, sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers import state_feedback as state_feedbacks
from flexfmu.cosim.control.controllers.from_control import LinearSystem, from_control
from flexfmu.cosim.control.controllers.h_infinity import closed_loop, coprime_controller, shape_loop, shaped_block, to_w
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


def two_joints() -> control.StateSpace:
    """Two motors, the first with a spring to a load, and a little of each torque at the other one."""
    k, motor, load = 400.0, 0.5, 0.2
    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = A[4, 5] = 1.0
    A[1, [0, 2]], A[3, [0, 2]] = (-k / motor, k / motor), (k / load, -k / load)
    B = np.zeros((6, 2))
    B[1], B[5] = (1.0 / motor, 0.2), (0.1, 1.5)
    C = np.zeros((2, 6))
    C[0, 0] = C[1, 4] = 1.0
    return control.ss(A, B, C, np.zeros((2, 2))).sample(H)


BANDWIDTH, TIMES = 2.0 * pi * np.array([6.0, 9.0]), np.array([0.15, 0.1])


@pytest.mark.parametrize(("matrices", "gamma"), [
    ((0, 1, 1, 0), sqrt(2.0)),
    (([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], 0), sqrt(4.0 + 2.0 * sqrt(2.0))),
    ((-1, 1, 1, 0), sqrt(1.0 + (sqrt(2.0) - 1.0) ** 2)),
])  # fmt: skip
def test_gamma_of_known_plants(matrices: Any, gamma: float) -> None:
    """1/s, 1/s2 and 1/(s + 1): from the Riccati equations by hand; X = Z = 1, and sqrt(2) - 1 for the third."""
    assert coprime_controller(control.ss(*matrices), 1.0 + 1e-12)[1] == pytest.approx(gamma, rel=1e-9)


@given(parts=st.lists(st.floats(-2.0, 2.0), min_size=11, max_size=11))
@settings(max_examples=50)
def test_transforms_are_inverse(parts: list[float]) -> None:
    """A system has the response of its equivalent in the w plane at w = 2/h (z - 1)/(z + 1), and Tustin's rule leads back."""
    A = np.reshape(parts[:4], (2, 2)) - 5.0 * np.eye(2)
    one = control.ss(A, np.reshape(parts[4:6], (2, 1)), np.reshape(parts[6:10], (2, 2)), [[parts[10]], [0.5]], True)
    other, z = to_w(one, 0.1), np.exp(0.7j)
    np.testing.assert_allclose(other(20.0 * (z - 1.0) / (z + 1.0)), one(z), atol=1e-11)
    np.testing.assert_allclose(other.sample(0.1, "tustin")(z), one(z), atol=1e-11)


def test_the_sampled_loop_has_the_norm_that_was_promised() -> None:
    """[I; K] (I - G W K)^-1 [I, G W] on the unit circle: its largest singular value is gamma, reached within 1 %, and not above."""
    plant = two_joints()
    found = shape_loop(plant, H, BANDWIDTH, TIMES)
    assert abs(np.linalg.eigvals(closed_loop(plant, found))).max() < 1.0
    peaks = []
    for angle in np.geomspace(1e-4, pi, 3000):
        z = np.exp(1j * angle)
        G, K = plant(z) @ found.weights(z), found.controller(z)
        whole = np.vstack([np.eye(2), K]) @ np.linalg.inv(np.eye(2) - G @ K) @ np.hstack([np.eye(2), G])
        peaks.append(np.linalg.svd(whole, compute_uv=False)[0])
    assert found.margin * max(peaks) <= 1.0 + 1e-6
    assert found.margin * max(peaks) > 1.0 / 1.1
    assert found.margin > 0.25
    # each weighted joint's own loop crosses 1 at its bandwidth
    for i, rate in enumerate(BANDWIDTH):
        z = np.exp(1j * rate * H)
        assert abs(plant(z)[i, i] * found.weights(z)[i, i]) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("limit", [None, 6.0])
def test_the_block_is_its_recursion_beside_an_exact_plant(limit: float | None) -> None:
    """A step of both references: angles and torques of 800 samples to 1e-12; the limit is reached, and left without windup."""
    plant = two_joints()
    found = shape_loop(plant, H, BANDWIDTH, TIMES)
    W, K, holding, target = found.weights, found.controller, np.array([1.5, -0.5]), np.array([0.02, -0.01])
    section = flexfmu.control.h_infinity(bandwidth=6.0, sample_time=H, torque_limit=limit)
    slave = BlockSlave(shaped_block(section, found, holding))
    names = [each.name for each in slave.variables]

    def places(text: str) -> NDArray[np.intp]:
        return np.array([names.index(text.format(i)) for i in (1, 2)])

    slave.set(places("joint{}.reference.position"), target)
    slave.set(places("joint{}.feedforward"), np.array([0.3, 0.1]))
    slave.initialize(0.0, 1.0, None)
    x, inside, outside, torques = np.zeros(6), np.zeros(len(K.A)), np.zeros(2), []
    for k in range(800):
        y = plant.C @ x
        # the block
        slave.set(places("joint{}.position"), y)
        slave.sample(k * H)
        torque = np.empty(2)
        slave.get(places("joint{}.torque"), torque)
        # the recursion
        shaped = K.C @ inside + K.D @ (y - target)
        wanted = holding + [0.3, 0.1] + W.C @ outside + W.D @ shaped
        expected = wanted if limit is None else np.clip(wanted, -limit, limit)
        np.testing.assert_allclose(torque, expected, rtol=1e-12, atol=1e-12)
        outside = W.A @ outside + W.B @ (shaped + np.linalg.solve(W.D, expected - wanted))
        inside = K.A @ inside + K.B @ (y - target)
        # the motors feel the deviation from the equilibrium
        x = plant.A @ x + plant.B @ (torque - holding - [0.3, 0.1])
        torques.append(torque)
    np.testing.assert_allclose(plant.C @ x, target, atol=1e-3)
    if limit is not None:
        assert np.abs(torques).max() == limit
        assert np.abs(torques[-1]).max() < limit


@pytest.mark.parametrize("design", [partial(h_infinity, bandwidth=12.0), lqg], ids=["H-infinity", "LQG"])
def test_coulomb_friction_is_no_damper(design: Callable[..., SymbolicBlock]) -> None:
    """At standstill its smooth model is a damper of 100 N.m.s/rad here, for which the loop of the moving robot would be unstable."""
    driven: Any = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "effects.proximal_bending": 0}
    scene = load_scene("barnard2012-6kg").replace({**driven, "effects.distal_axial": 0})
    blocks = [
        design(scene=each, sample_time=H)
        for each in (scene, scene.replace({"effects.joint_friction": {"coulomb": 1.0}}))
    ]
    x = np.linspace(-1.0, 1.0, len(blocks[0].states))
    u = np.array([3.2, 1.2, 3.1, 1.3, 0.0, 0.0])[: len(blocks[0].inputs)]
    first, second = (np.asarray(each.update(x, u, [])) for each in blocks)
    np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-9)


def test_a_bandwidth_beyond_half_the_sampling_frequency_is_refused() -> None:
    """Told before the robot is linearised."""
    with pytest.raises(InputError, match="below half the sampling frequency, 500 Hz, got 500 Hz"):
        h_infinity(bandwidth=500.0, sample_time=H)
