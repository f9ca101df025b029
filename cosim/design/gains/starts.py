"""Gains to start from: each joint as its inertia alone, its loop shaped by a bandwidth.

With J the joint's inertia at a pose (the diagonal of the rigid robot's mass matrix, motor included) and w = 2 pi bandwidth, the closed
loop of a rigid joint has

- ``pd``: two poles at -w: K_p = J w², K_d = 2 J w;
- ``pid``: three poles at -w: K_p = 3 J w², K_d = 3 J w, K_i = J w³;
- ``cascade``: the position loop crosses 1 at w, the velocity loop at 4 w, with an integral time of 1/w: K_v = w, K_p = 4 J w,
  K_i = 4 J w² (H. Gross, J. Hamann, G. Wiegärtner, Electrical Feed Drives in Automation, 2001, chapters 4 and 5: a factor of 4 between
  neighbouring corner frequencies, the symmetrical optimum).

Elasticity, holds and delays are not in it: a bandwidth of a tenth of the lowest natural frequency and a fiftieth of the sampling
frequency is a safe start.
"""

from __future__ import annotations

from math import isfinite, pi
from typing import Any, Literal, get_args

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import positions_along

StartKind = Literal["pd", "pid", "cascade"]
"""Kinds of controllers that there are gains for."""

Pose = Literal["start", "middle", "end"]

ADDED = ("feedforward", "learning")
"""Kinds of controllers that only add to another one's torque: they stay."""

SAMPLE_TIME = 1e-3
"""Sample time where the scene has no controller to take it from [s]."""


def start_controller(
    scene: Scene, kind: StartKind, bandwidth: float, pose: Pose = "end", sample_time: float | None = None
) -> dict[str, Any]:
    """Return the table of a controller with gains for a bandwidth, as `Scene.replace` takes it.

    Args:
        scene: the robot; torques drive it.
        kind: ``pd``, ``pid`` or ``cascade``.
        bandwidth: [Hz].
        pose: where the inertia is taken.
        sample_time: [s]; None for that of the scene's first controller, or 1 ms.

    Raises:
        InputError: the kind is unknown, the bandwidth isn't positive, or the scene isn't driven by torques.
        TrajectoryError: the motion is not feasible.
    """
    if kind not in get_args(StartKind):
        raise InputError(f"there are no gains to start from for {kind!r}; choose from {', '.join(get_args(StartKind))}")
    if not (isfinite(bandwidth) and bandwidth > 0.0):
        raise InputError(f"a bandwidth must be positive, got {bandwidth:g} Hz")
    if scene.cosimulation.drive != "torque":
        raise InputError(f'scene {scene.name} has no loop: set `cosimulation.drive = "torque"`')
    own = [found for each in scene.controller if (found := getattr(each, "sample_time", None)) is not None]
    h = sample_time or (own[0] if own else SAMPLE_TIME)
    w, inertia = 2.0 * pi * bandwidth, joint_inertias(scene, pose)

    def rounded(values: RealArray) -> list[float]:
        return [float(f"{each:.5g}") for each in values.tolist()]

    if kind == "cascade":
        velocity = {"proportional": rounded(4.0 * w * inertia), "integral": rounded(4.0 * w**2 * inertia)}
        return {"kind": kind, "position": {"proportional": float(f"{w:.5g}")}, "velocity": velocity, "sample_time": h}
    factor = 2.0 if kind == "pd" else 3.0
    table: dict[str, Any] = {"kind": kind, "proportional": rounded((factor if kind == "pid" else 1.0) * w**2 * inertia)}
    table |= {"derivative": rounded(factor * w * inertia)}
    table |= {"integral": rounded(w**3 * inertia)} if kind == "pid" else {}
    return {**table, "sample_time": h}


def started(scene: Scene, kind: StartKind, bandwidth: float, pose: Pose = "end") -> Scene:
    """Return the scene with this controller in place of those that control: feedforward and learning stay; errors as above."""
    controllers = scene.model_dump(exclude_none=True)["controller"]
    others = [each for each in controllers if each["kind"] in ADDED]
    return scene.replace({"controller": [start_controller(scene, kind, bandwidth, pose), *others]})


def joint_inertias(scene: Scene, pose: Pose = "end") -> RealArray:
    """Return the diagonal of the rigid robot's mass matrix at a pose (2,) [kg.m2]: links, payload and motors.

    Raises:
        InputError: there is no such pose.
        TrajectoryError: the motion is not feasible.
    """
    from flexfmu.model.numeric import inverse_dynamics  # needs CasADi

    shares = {"start": 0.0, "middle": 0.5, "end": 1.0}
    if pose not in shares:
        raise InputError(f"there is no pose {pose!r}; choose from {', '.join(shares)}")
    x, y = positions_along(plan(scene).task, shares[pose])[0].tolist()
    angles, torque = np.array(motor_angles(scene.mechanism, (x, y))), inverse_dynamics(scene)
    rest = np.zeros(2)
    still = np.asarray(torque(angles, rest, rest)).ravel()
    columns = [np.asarray(torque(angles, rest, unit)).ravel() - still for unit in np.eye(2)]
    return np.array([columns[0][0], columns[1][1]])
