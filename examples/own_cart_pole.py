"""A cart-pole from its energies, and the controller that its linearisation gives: LQR, sampled, in the loop.

python own_cart_pole.py
"""

import casadi
import control
import numpy as np

import flexfmu

cart_pole = flexfmu.lagrangian(
    "cart_pole",
    q={"position": flexfmu.variable(0.0, "m"), "angle": flexfmu.variable(0.3, "rad")},
    p={
        "cart": flexfmu.variable(2.0, "kg"),
        "pole": flexfmu.variable(0.5, "kg"),
        "length": flexfmu.variable(0.6, "m"),
        "friction": flexfmu.variable(0.1, "N.s/m"),
    },
    u={"force": flexfmu.variable(0.0, "N")},
    kinetic=lambda q, v, p: (
        0.5 * (p.cart + p.pole) * v.position**2
        + p.pole * p.length * casadi.cos(q.angle) * v.position * v.angle
        + 0.5 * p.pole * (p.length * v.angle) ** 2
    ),
    potential=lambda q, p: 9.81 * p.pole * p.length * casadi.cos(q.angle),
    dissipation=lambda v, p: 0.5 * p.friction * v.position**2,
    forces=lambda u: {"position": u.force},
)

if __name__ == "__main__":
    # upright; states are position, angle and their rates
    upright = flexfmu.linearize(cart_pole, {"angle": 0.0})
    gain = control.lqr(upright, np.diag([10.0, 100.0, 1.0, 1.0]), [[0.1]])[0].ravel()

    @flexfmu.controller(sample_time=5e-3, inputs=["x", "phi", "dx", "dphi"], outputs=["force"])
    def lqr(measurement, *, gain=tuple(gain)):
        """State feedback."""
        return -sum(k * m for k, m in zip(gain, measurement, strict=True))

    wires = {"lqr.x": "position", "lqr.phi": "angle", "lqr.dx": "der(position)", "lqr.dphi": "der(angle)"}
    connections = {target: f"cart_pole.{source}" for target, source in wires.items()}
    for controlled in (False, True):
        slaves, wired = (
            ([cart_pole, lqr], connections | {"cart_pole.force": "lqr.force"}) if controlled else ([cart_pole], {})
        )
        run = flexfmu.simulate(slaves, wired, stop_time=6.0, step=5e-3).recording
        label = "with LQR" if controlled else "alone"
        angle, position = (run[f"cart_pole.{name}"].values for name in ("angle", "position"))
        print(
            f"{label:10} angle at the end {angle[-1]:7.4f} rad, cart {position[-1]:7.4f} m, at most {abs(position).max():.3f} m"
        )
