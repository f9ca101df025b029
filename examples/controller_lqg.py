"""An LQG controller with python-control: linearise the robot, discretise, regulator, Kalman filter, and into the loop.

Measured are the motor angles alone; what the links do is estimated.

    python controller_lqg.py
"""

import control
import numpy as np

import flexfmu

ANGLES = ("joint1.position", "joint2.position")

# a small motion: 5 mm up, 20 mm across
scene = flexfmu.load_scene("barnard2012-6kg").replace(
    {
        "effects.motor_inertia": 0.1,
        "trajectory.start": [-0.01, 0.3],
        "trajectory.height": 0.005,
        "trajectory.width": 0.020,
        "trajectory.blend": {"kind": "lame", "height": 0.005, "width": 0.005},
        "trajectory.duration": 0.1,
    }
)

# the robot at rest in the middle, in deviations from its equilibrium, for torques held over 1 ms
pose = (0.0, 0.3)
robot = flexfmu.linearize(scene, pose, ANGLES)[:, :2]
plant = flexfmu.control.from_control(robot.sample(1e-3))

# 0.1 mrad of an angle counts like 10 N.m; the filter expects torques disturbed by 1 N.m, angles measured to 1e-5 rad
K, _, _ = control.dlqr(plant.A, plant.B, plant.C.T @ plant.C / 1e-4**2, np.eye(2) / 10.0**2)
L, _, _ = control.dlqe(plant.A, plant.B, plant.C, 1.0**2 * np.eye(2), 1e-5**2 * np.eye(2))

point = flexfmu.control.operating_point(scene, pose)
rest = flexfmu.control.Equilibrium(inputs=point.inputs[:2].tolist(), outputs=point.coordinates[:2].tolist())
reference = flexfmu.control.static_feedforward(plant, ANGLES, rest)
angles = flexfmu.reference_motion(scene).joints.evaluate([0.0], order=0)[0, 0]
start = angles - np.array(rest.outputs)  # where the estimate begins
controller = flexfmu.control.state_feedback(
    plant, K, L, reference=reference, equilibrium=rest, estimate=reference.Nx @ start, name="lqg"
)

poles = np.linalg.eigvals(plant.A - plant.B @ K)
print(f"order {plant.order}, slowest pole {np.log(abs(poles).max()) / 1e-3:.1f} 1/s")
run = flexfmu.run(scene, controllers=[controller])
error = run.recording["joint1.position"].values - run.recording["joint1.reference.position"].values
print(f"largest tracking error {1e3 * abs(error).max():.3f} mrad, at the end {1e3 * abs(error[-1]):.5f} mrad")
