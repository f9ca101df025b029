"""A controller of your own as a function: a decorator names its signals, sample time and state.

NumPy's and CasADi's operations make it a block, which runs in C and leaves as an FMU; with `if` it would stay in Python.

    python custom_function.py
"""

from pathlib import Path

import numpy as np

import flexfmu


@flexfmu.controller(sample_time=1e-3, state=[0.0, 0.0])
def own_pid(reference, measurement, state, *, proportional=1e4, integral=1e5, derivative=100.0, limit=120.0):
    """PID control whose integral stops at the torque's limit."""
    # positions of both joints, then their velocities
    error, rate = reference[:2] - measurement[:2], reference[2:] - measurement[2:]
    torque = proportional * error + derivative * rate + state
    following = np.where(abs(torque) < limit, state + 1e-3 * integral * error, state)
    return np.clip(torque, -limit, limit), following


if __name__ == "__main__":
    robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
    python = flexfmu.run(robot, controllers=[own_pid])

    # as a table of a scene file: arguments are the parameters, which the exported FMU has too
    table = flexfmu.control.python(source="custom_function:own_pid", arguments={"limit": 80.0})
    limited = flexfmu.run(robot, controllers=[table])
    for label, run in (("Python", python), ("scene file, 80 N.m", limited)):
        print(f"{label:20} tracking error {1e3 * run.metrics.peak_tracking_error_1:.4f} mrad")

    system = flexfmu.export_slaves(limited.scene, Path("fmus"), names=["own_pid"])
    print(f"exported: {system.slaves[0].path.name}, {system.slaves[0].facts.description}")
