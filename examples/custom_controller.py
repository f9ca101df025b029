"""A controller of your own: any class with these few methods is a slave, in Python and in scene files as module:Class.

This one ties the joints to their references by springs and dampers.

    python custom_controller.py
"""

import numpy as np

import flexfmu

KINDS = {"reference.position": "rad", "reference.velocity": "rad/s", "position": "rad", "velocity": "rad/s"}


class SpringsAndDampers:
    """Sampled: the master calls `set`, then `sample` at every sample instant, and reads `get`."""

    name = "springs"

    def __init__(self, stiffness: float, damping: float, sample_time: float = 1e-3) -> None:
        self.stiffness, self.damping, self.sample_time = stiffness, damping, sample_time
        variable = flexfmu.SlaveVariable
        inputs = [variable(f"joint{j}.{kind}", "input", unit) for kind, unit in KINDS.items() for j in (1, 2)]
        outputs = [variable(f"joint{joint}.torque", "output", "N.m") for joint in (1, 2)]
        self.variables = (*inputs, *outputs)
        self.values = np.zeros(len(self.variables))

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.sample(start_time)

    def set(self, indices: np.ndarray, values: np.ndarray) -> None:
        self.values[indices] = values

    def get(self, indices: np.ndarray, values: np.ndarray) -> None:
        values[:] = self.values[indices]

    def sample(self, time: float) -> None:
        reference, rate, angle, velocity, _ = self.values.reshape(5, 2)
        self.values[8:] = self.stiffness * (reference - angle) + self.damping * (rate - velocity)

    def step(self, time: float, step: float) -> None:
        """Nothing happens between samples."""


if __name__ == "__main__":
    robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
    python = flexfmu.run(robot, controllers=[SpringsAndDampers(10e3, 100.0)])

    # as a table of a scene file
    table = flexfmu.control.python(
        source="custom_controller:SpringsAndDampers", arguments={"stiffness": 10e3, "damping": 100.0}
    )
    scene_file = flexfmu.run(robot, controllers=[table])
    for label, run in (("Python", python), ("scene file", scene_file)):
        print(f"{label:12} tracking error {1e3 * run.metrics.peak_tracking_error_1:.4f} mrad")
