"""Computed torque: the rigid robot becomes two independent unit masses, whatever its pose."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import casadi
import numpy as np
from blocks import computed_torque, feedforward, responses
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.code import COMPILED_FROM, block_function
from flexfmu.cosim.experiment.planning import plan
from flexfmu.fmu_build.block_build import sample_function
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.file import load_scene

Array = NDArray[np.float64]

H = 2.5e-4
K_P, K_D = np.array([900.0, 1600.0]), np.array([60.0, 72.0])
ORDER = ("reference.position", "reference.velocity", "reference.acceleration", "position", "velocity")


@cache
def rigid() -> casadi.Function:
    """Inverse dynamics of the paper's robot with 6 kg, rigid links."""
    return inverse_dynamics(load_scene("barnard2012-6kg"))


@cache
def pose() -> Array:
    """Motor angles at the start of the motion."""
    return np.asarray(plan(load_scene("barnard2012-6kg")).joints.evaluate(np.array([0.0]))[0, 0])


def forward(q: Array, v: Array, torque: Array) -> Array:
    """Accelerations of the rigid robot: its inverse dynamics are affine in them."""
    bias = np.asarray(rigid()(q, v, np.zeros(2)))[:, 0]
    mass = np.column_stack([np.asarray(rigid()(q, v, unit))[:, 0] - bias for unit in np.eye(2)])
    return np.linalg.solve(mass, torque - bias)


def named(values: Mapping[str, Array]) -> dict[str, Array]:
    """Kind → (N, 2) as joint variable → (N,)."""
    return {f"joint{i + 1}.{kind}": value[:, i] for kind, value in values.items() for i in range(2)}


def random_motion(count: int) -> dict[str, Array]:
    """References and measurements about the start pose, (count, 2) each."""
    rng = np.random.default_rng(3)
    scale = {"position": 0.1, "velocity": 5.0, "acceleration": 100.0}
    return {
        kind: (pose() if kind.endswith("position") else 0.0)
        + scale[kind.rpartition(".")[2]] * rng.uniform(-1.0, 1.0, (count, 2))
        for kind in ORDER
    }


def test_linearises_the_rigid_plant_exactly() -> None:
    """The rigid robot's acceleration is the reference's plus K_d e' + K_p e, to rounding, in any pose and motion."""
    motion = random_motion(30)
    torque = responses(computed_torque(K_P, K_D, sample_time=H), named(motion))
    found = np.array(
        [
            forward(motion["position"][k], motion["velocity"][k], np.array([each[k] for each in torque.values()]))
            for k in range(30)
        ]
    )
    wanted = (
        motion["reference.acceleration"]
        + K_D * (motion["reference.velocity"] - motion["velocity"])
        + K_P * (motion["reference.position"] - motion["position"])
    )
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-10 * abs(wanted).max())


def test_torque_on_the_path_is_the_inverse_dynamics() -> None:
    """Without error the controller gives the rigid torques of the motion, as the mere feedforward does."""
    motion = plan(load_scene("barnard2012-6kg")).joints.evaluate(np.linspace(0.01, 0.42, 30))
    references = {f"reference.{kind}": motion[i] for i, kind in enumerate(("position", "velocity", "acceleration"))}
    measured = {"position": motion[0], "velocity": motion[1]}
    wanted = np.array([np.asarray(rigid()(*motion[:, k]))[:, 0] for k in range(30)])
    block = computed_torque(K_P, K_D, sample_time=H)
    found = np.array(list(responses(block, named(references | measured)).values())).T
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * abs(wanted).max())
    ahead = responses(feedforward(sample_time=H), named(references))
    np.testing.assert_allclose(np.array(list(ahead.values())).T, wanted, rtol=0, atol=1e-12 * abs(wanted).max())


def test_a_sample_is_compiled() -> None:
    """The inverse dynamics are large enough to run as C, and take less than 400 operations."""
    block = computed_torque(K_P, K_D, sample_time=H)
    assert COMPILED_FROM <= sample_function(block).n_instructions() < 400
    assert block_function(block).class_name() == "External"
    assert block_function(block, compiled=False).is_a("SXFunction")
