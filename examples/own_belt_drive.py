"""DC motors with belts as the drives of the five-bar: their sampled PD is in the same FMU, and the whole system leaves as SSP.

python own_belt_drive.py
"""

import numpy as np

import flexfmu

JOINTS = ("joint1", "joint2")


@flexfmu.controller(sample_time=1e-3, inputs=["e1", "e2", "rate1", "rate2"], outputs=["voltage1", "voltage2"])
def pd(measurement, *, kp=1500.0, kd=10.0):
    """Voltages from the errors of the rotors' angles and rates."""
    return [kp * measurement[i] + kd * measurement[i + 2] for i in range(2)]


def belt(q, v, u, p, k):
    """Torque of a belt on its joint; all angles are those of the joint's side."""
    stretch, rate = q[f"rotor{k}"] - u[f"joint{k}.position"], v[f"rotor{k}"] - u[f"joint{k}.velocity"]
    return p.stiffness * stretch + p.damping * rate


def drive(start):
    """The drives of both joints; rotors start at the joints' angles [rad]."""
    signals = {
        f"{each}.{what}{kind}" for each in JOINTS for what in ("reference.", "") for kind in ("position", "velocity")
    }
    return flexfmu.second_order(
        "drive",
        q={f"rotor{k}": flexfmu.variable(angle, "rad", nominal=1.0) for k, angle in enumerate(start, 1)},
        x={f"current{k}": flexfmu.variable(0.0, "A", nominal=10.0) for k in (1, 2)},
        u={each: flexfmu.variable(0.0, "rad" if each.endswith("position") else "rad/s") for each in sorted(signals)},
        p={"inertia": 0.1, "torque": 4.0, "resistance": 0.5, "inductance": 1e-3, "stiffness": 5e4, "damping": 50.0},
        residual=lambda q, v, a, u, x, p: [
            p.inertia * each - p.torque * x[f"current{k}"] + belt(q, v, u, p, k) for k, each in enumerate(a, 1)
        ],
        rhs=lambda v, x, p: [
            (x[f"pd.voltage{k}"] - p.resistance * x[f"current{k}"] - p.torque * v[f"rotor{k}"]) / p.inductance
            for k in (1, 2)
        ],
        outputs={
            f"joint{k}.torque": flexfmu.variable(lambda q, v, u, p, k=k: belt(q, v, u, p, k), "N.m") for k in (1, 2)
        },
        parts={
            "pd": flexfmu.part(
                pd,
                lambda q, v, u: [
                    *(u[f"{joint}.reference.position"] - each for joint, each in zip(JOINTS, q, strict=True)),
                    *(u[f"{joint}.reference.velocity"] - each for joint, each in zip(JOINTS, v, strict=True)),
                ],
            )
        },
    )


if __name__ == "__main__":
    robot = flexfmu.load_scene("barnard2012-6kg").replace(
        {"cosimulation.drive": "torque", "effects.gravity": [0.0, 0.0], "effects.motor_inertia": 0.01}
    )
    start = flexfmu.reference_motion(robot).joints.evaluate(np.zeros(1), order=0)[0, 0]
    path = flexfmu.build(drive(start), "drive.fmu", step=robot.cosimulation.step)
    run = flexfmu.run(robot, controllers=[path])
    error = abs(run.recording["joint1.position"].values - run.recording["joint1.reference.position"].values).max()
    print(f"{run.message}; largest error of joint 1 {1e3 * error:.2f} mrad")
    # inputs of the drive are named as the robot's outputs, and its outputs as the robot's inputs: so they are connected
    found = flexfmu.load_ssp(flexfmu.export_ssp(run.scene, "driven.ssp")).simulate().recording
    name = "end_effector.position.x"
    print(f"the SSP file gives the same within {abs(found[name].values - run.recording[name].values).max():.0e} m")
