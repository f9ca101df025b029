"""Planned motions in the sampled loop of a scene: its controllers with their sample times, encoders and delays follow the joint references.

Delays and velocities from encoders pull a robot off its motion even where the feedforward has all torques of the motion. What the controllers
would answer to the tracking error of a run is added to the feedforward of the next run; rounding and noise, which don't repeat, are left out
of what is learned.

Source: D. A. Bristow, M. Tharayil, A. G. Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26 (2006) 96.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, inf
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.experiment.scene_loop import own_loop
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.kinematics import load_mass_matrix
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

RUNS, SETTLED = 8, 0.03
"""Runs from which the feedforward is learned, and time after the motion up to which it is corrected [s]."""

AHEAD, SMOOTHED = 1.5, 20
"""How many samples later the error tells what a torque lacks, and how often corrections are averaged over three samples: a loop amplifies
what changes from sample to sample."""

WITHOUT_ROUNDING: Mapping[str, Any] = {"encoder": {"counts_per_turn": 1e12}, "quantisation": {"resolution": 1e-12}}
"""Imperfections → keys with which they hardly round."""


def joint_motion(joints: Trajectory) -> Trajectory:
    """References of the joints as an own motion [rad]; they may be the shaped ones of a plan."""
    motion = SimpleNamespace(
        coordinates="joints", duration=joints.duration, breakpoints=joints.breakpoints, evaluate=joints.evaluate
    )
    return cast(Trajectory, motion)


def completed(run: Run, what: str) -> Run:
    """A run that has reached its end.

    Raises:
        ResultsError: it failed.
        KeyboardInterrupt: after Ctrl-C, which ends a run early.
    """
    if run.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if not run.completed:
        raise ResultsError(f"{what}: {run.message}")
    return run


def loop_run(scene: Scene, joints: Trajectory, dwell: float = 0.0) -> Run:
    """The run of joint references with the controllers of a scene.

    Args:
        scene: with controllers.
        joints: references q11 and q21 [rad].
        dwell: standstill after the motion [s], at least; that of the scene if it is longer.

    Raises:
        TrajectoryError: the motion isn't feasible.
        ResultsError: the loop is unstable, or fails otherwise.
        KeyboardInterrupt: after Ctrl-C, which ends a run early.
    """
    changes = {"shaper": [], "trajectory.dwell": max(scene.trajectory.dwell, dwell)}
    loop = own_loop(scene.replace(changes), joint_motion(joints))
    run = PreparedScene(loop.motion.scene, loop=loop).run()
    return completed(run, f"the motion with the controllers of scene {scene.name}")


def with_learned_torques(scene: Scene, joints: Trajectory, dwell: float = 0.0) -> Scene:
    """The scene with a corrected feedforward, with which its loop follows references most closely.

    Of the runs from which it is learned that one counts which leaves the least vibration. A scene without the flexible robot's feedforward as
    its last controller, or with other controllers than one PD or PID, stays as it is. Arguments and errors as for `loop_run`.
    """
    gains, last = [each for each in scene.controller if each.kind in ("pd", "pid")], scene.controller[-1]
    if last.kind != "feedforward" or last.robot != "flexible" or last.sample_time is None or len(gains) != 1:
        return scene
    data = scene.model_dump(exclude_none=True)
    repeating = [each for each in data["imperfection"] if each["kind"] not in ("noise", "jitter")]
    repeating = [{**each, **WITHOUT_ROUNDING.get(each["kind"], {})} for each in repeating]
    count = ceil((joints.duration + SETTLED) / last.sample_time)
    instants = last.sample_time * (np.arange(count) + AHEAD)
    motion = joints.evaluate(np.minimum(instants, joints.duration), 1, "left")
    motion[1, instants > joints.duration] = 0.0
    # what turns, as rigid: with gains alone what is faster than the loop would hardly be learned
    masses = load_mass_matrix(scene, motion[0]).diagonal(axis1=1, axis2=2) + scene.effects.motor_inertia
    # one row more, of zeros, which holds on
    correction, best = np.zeros((count + 1, 2)), (inf, scene)

    def corrected(torques: RealArray, imperfections: list[Any]) -> Scene:
        feedforward = {**data["controller"][-1], "correction": np.round(torques, 7).tolist()}
        return scene.replace({"controller": [*data["controller"][:-1], feedforward], "imperfection": imperfections})

    for _ in range(RUNS):
        run = loop_run(corrected(correction, repeating), joints, dwell)
        if (residual := float(run.metrics["residual_vibration_amplitude"])) < best[0]:
            best = residual, corrected(correction, data["imperfection"])
        for joint in range(2):
            signals = (run.recording[f"joint{joint + 1}.{name}"].values for name in ("position", "velocity"))
            found = [np.interp(instants, run.recording.time, each) for each in signals]
            position, velocity = motion[:, :, joint] - found
            torque = gains[0].proportional[joint] * position + gains[0].derivative[joint] * velocity
            torque += masses[:, joint] * np.gradient(velocity, last.sample_time)
            for _ in range(SMOOTHED):
                torque = np.convolve(np.pad(torque, 1, mode="edge"), (0.25, 0.5, 0.25), mode="valid")
            correction[:-1, joint] += torque
    return best[1]


def left_in_loop(scene: Scene, joints: Trajectory, dwell: float) -> tuple[float, str]:
    """The residual vibration [m] that a loop leaves, and its tracking error in words; arguments and errors as for `loop_run`."""
    metrics = loop_run(scene, joints, dwell).metrics
    error = max(float(metrics[f"peak_tracking_error_{joint}"]) for joint in (1, 2))
    return float(metrics["residual_vibration_amplitude"]), f"tracking error {1e3 * error:.3g} mrad"
