"""An arm of two joints whose forearm bends, behind a PD controller: kinetic energy by quadrature along the forearm.

python own_flexible_arm.py
"""

import casadi
import numpy as np

import flexfmu

UPPER, FORE, TIP = 0.4, 0.5, 0.2  # lengths [m], mass at the tip [kg]
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)


def point(q, along):
    """Position of a point of the forearm, ``along`` of its length from the elbow; it bends in the shape along²."""
    elbow = UPPER * casadi.vertcat(casadi.cos(q.shoulder), casadi.sin(q.shoulder))
    angle, bend = q.shoulder + q.elbow, q.bend * along**2
    return elbow + casadi.vertcat(
        FORE * along * casadi.cos(angle) - bend * casadi.sin(angle),
        FORE * along * casadi.sin(angle) + bend * casadi.cos(angle),
    )


def kinetic(q, v, p):
    """Motors with the upper arm, forearm and tip."""

    def energy(mass, along):
        velocity = casadi.jtimes(point(q, along), casadi.vertcat(*q), casadi.vertcat(*v))
        return 0.5 * mass * casadi.sumsqr(velocity)

    forearm = sum(energy(0.5 * w * p.forearm, 0.5 * (1 + x)) for x, w in zip(POINTS, WEIGHTS, strict=True))
    return 0.5 * p.inertia * v.shoulder**2 + forearm + energy(TIP, 1.0)


arm = flexfmu.lagrangian(
    "arm",
    q={
        "shoulder": flexfmu.variable(0.0, "rad"),
        "elbow": flexfmu.variable(1.0, "rad"),
        "bend": flexfmu.variable(0.0, "m", nominal=1e-3),
    },
    p={
        "inertia": 0.1,
        "forearm": flexfmu.variable(0.3, "kg"),
        "stiffness": flexfmu.variable(2e3, "N/m"),
        "damping": 2.0,
    },
    u={"torque1": flexfmu.variable(0.0, "N.m"), "torque2": flexfmu.variable(0.0, "N.m")},
    kinetic=kinetic,
    potential=lambda q, p: 0.5 * p.stiffness * q.bend**2,
    dissipation=lambda v, p: 0.5 * p.damping * v.bend**2,
    forces=lambda u: {"shoulder": u.torque1, "elbow": u.torque2},
    outputs={
        "tip.x": flexfmu.variable(lambda q: point(q, 1.0)[0], "m"),
        "tip.y": flexfmu.variable(lambda q: point(q, 1.0)[1], "m"),
    },
)


@flexfmu.controller(sample_time=1e-3, inputs=["q1", "q2", "w1", "w2"], outputs=["torque1", "torque2"])
def pd(measurement, *, target=(0.4, 0.8), kp=8.0, kd=2.0):
    """Towards fixed joint angles."""
    return [kp * (target[i] - measurement[i]) - kd * measurement[i + 2] for i in range(2)]


if __name__ == "__main__":
    wires = {"pd.q1": "shoulder", "pd.q2": "elbow", "pd.w1": "der(shoulder)", "pd.w2": "der(elbow)"}
    wired = {target: f"arm.{source}" for target, source in wires.items()}
    wired |= {f"arm.torque{k}": f"pd.torque{k}" for k in (1, 2)}
    for stiffness in (1e3, 4e3, 1e5):
        slaves = [flexfmu.slave(arm, parameters={"stiffness": stiffness}), pd]
        run = flexfmu.simulate(slaves, wired, stop_time=2.0, step=1e-3).recording
        bend = abs(run["arm.bend"].values).max()
        tip = [run[f"arm.tip.{axis}"].values[-1] for axis in "xy"]
        print(f"{stiffness:8.0f} N/m: bends by {1e3 * bend:7.3f} mm, tip at the end {tip[0]:.4f}, {tip[1]:.4f} m")
