"""H-infinity loop shaping: gamma of known plants, norms of the sampled loop, the block against a recursion in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi, sqrt
from typing import Any

import control
import numpy as np
import pytest
from blocks import h_infinity, lqg
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.h_infinity import closed_loop, coprime_controller, shape_loop, shaped_block, to_w
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]
H = 1e-3


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
