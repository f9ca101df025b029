"""Critical gains that margins predict, against those of simulations: two robots, five poses, loops with one and with several rates.

Torques are multiplied by a factor. The simulation's critical factor is where small motions about standstill neither grow nor
fade: between 1 % below and 1 % above the predicted one, by linear interpolation of their rates of growth.

python benchmarks/critical_gains.py [--poses N]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import flexfmu
from flexfmu.cosim.control.blocks.equations import block
from flexfmu.cosim.design.margins.margins import ALL
from flexfmu.cosim.experiment.scene_loop import own_loop
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.cosim.experiment.wiring import inline_block
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.symbolic import SymbolicBlock, Variable

DRIVEN: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "cosimulation.tolerance": 1e-8,
    "effects.motor_inertia": 0.1,
    # little gravity sets the robot into small motions, which stay linear
    "effects.gravity": [0.0, -1e-4],
}

LOOPS: dict[str, dict[str, Any]] = {
    "PD, 1 kHz": {
        "controller": [{"kind": "pd", "proportional": 1e4, "derivative": 60.0, "sample_time": 1e-3}],
    },
    "PID 1 kHz, encoders 4 kHz over 3 samples, delay 0.3 ms, lag 0.2 ms": {
        "controller": [
            {"kind": "pid", "proportional": 800.0, "integral": 2e3, "derivative": 5.0, "filter_time": 1e-3, "sample_time": 1e-3}
        ],
        "imperfection": [
            {"kind": "encoder", "counts_per_turn": 1e12, "window": 3, "sample_time": 2.5e-4},
            {"kind": "delay", "signal": "torque", "time": 3e-4, "sample_time": 2.5e-4},
            {"kind": "lag", "signal": "torque", "time_constant": 2e-4},
        ],
    },
}  # fmt: skip
"""Controllers and imperfections of each loop."""

LENGTHS, LIMITS = 12.0, (0.6, 5.0)
"""Simulated time in time constants of the predicted growth, and its limits [s]; small motions are watched in the second half."""


@dataclass(frozen=True, eq=False)
class Standstill:
    """Joints that stand still; a trajectory."""

    angles: tuple[float, float]
    duration: float
    coordinates: str = "joints"

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Its ends [s]."""
        return 0.0, self.duration

    def evaluate(self, time: Any, order: int = 2, side: str = "right") -> Any:
        """Joint angles [rad] and their derivatives."""
        found = np.zeros((order + 1, np.size(time), 2))
        found[0] = self.angles
        return found


def gain(factor: float, sample_time: float) -> SymbolicBlock:
    """Both torques times a factor."""
    joints = ("joint1", "joint2")
    return block(
        "gain",
        "Torques times a factor",
        lambda x, u, p: (factor * u, x),
        sample_time=sample_time,
        inputs=[Variable(f"{joint}.torque.input", "N.m", "Torque", "input", 0.0) for joint in joints],
        outputs=[Variable(f"{joint}.torque", "N.m", "Torque", "output") for joint in joints],
    )


def growth(scene: flexfmu.Scene, angles: tuple[float, float], factor: float, length: float) -> float:
    """Rate of growth of small motions about standstill with torques times a factor, from a simulation [1/s]."""

    loop = own_loop(scene, Standstill(angles, length))
    # at the controller's instants, before delays and lags
    names = SlaveNames()
    extra = inline_block(as_slave(gain(factor, 1e-3), names))
    loop = replace(loop, inline_blocks=(extra, *loop.inline_blocks))
    run = PreparedScene(loop.motion.scene, loop=loop).run()
    time, torque = run.recording.time, run.recording["gain.joint1.torque"].values
    change = np.abs(np.diff(torque))
    first, second = (
        np.sqrt(np.mean(change[(time[1:] > a * length) & (time[1:] <= (a + 0.25) * length)] ** 2)) for a in (0.5, 0.75)
    )
    return float(np.log(second / first) / (0.25 * length))


def cases(poses: int) -> Iterator[tuple[str, str, float, float, float]]:
    """Robot, loop, place on the path, predicted critical factor, simulated one."""
    for robot in ("barnard2012-6kg", "examples/tubes.toml"):
        for name, keys in LOOPS.items():
            scene = flexfmu.load_scene(robot).replace({**DRIVEN, **keys, "trajectory.dwell": 0.0})
            found = flexfmu.margins(scene, poses=poses)
            for pose, linear in zip(found.poses, found.linear, strict=True):
                predicted = next(row.gain_margin for row in pose.loops if row.channel == ALL)
                rate = np.log(
                    np.abs(np.linalg.eigvals(linear.closed([1.01 * predicted] * 2, [0.0] * 2))).max()
                ) / float(linear.period)
                length = float(np.clip(LENGTHS / rate, *LIMITS))
                below, above = (growth(scene, pose.joints, share * predicted, length) for share in (0.99, 1.01))
                simulated = predicted * (0.99 + 0.02 * below / (below - above))
                yield scene.name, name, pose.s, predicted, simulated


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=5)
    worst = 0.0
    for robot, name, s, predicted, simulated in cases(parser.parse_args().poses):
        error = simulated / predicted - 1.0
        worst = max(worst, abs(error))
        print(f"{robot} | {name} | {s:.2f} | {predicted:.4f} | {simulated:.4f} | {100 * error:+.3f} %")
    print(f"largest difference: {100 * worst:.3f} %")


if __name__ == "__main__":
    main()
