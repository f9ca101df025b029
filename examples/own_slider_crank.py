"""A slider-crank whose rod bends: the loop is closed by hand, so that crank angle and bending are all coordinates, and nothing drifts.

python own_slider_crank.py
"""

import casadi
import numpy as np

import flexfmu

CRANK, ROD = 0.05, 0.2  # lengths [m]
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)


def point(q, along):
    """Position of a point of the rod, ``along`` of its length from the crank pin; it bends as a half sine."""
    pin = CRANK * casadi.vertcat(casadi.cos(q.crank), casadi.sin(q.crank))
    # the slider stays on the x axis: the rod's slope follows from the crank
    sine = -CRANK * casadi.sin(q.crank) / ROD
    cosine = casadi.sqrt(1 - sine**2)
    bend = q.bend * np.sin(np.pi * along)
    return pin + casadi.vertcat(ROD * along * cosine - bend * sine, ROD * along * sine + bend * cosine)


def kinetic(q, v, p):
    """Crank with flywheel, rod by quadrature, slider."""

    def energy(mass, along):
        velocity = casadi.jtimes(point(q, along), casadi.vertcat(*q), casadi.vertcat(*v))
        return 0.5 * mass * casadi.sumsqr(velocity)

    rod = sum(energy(0.5 * w * p.rod, 0.5 * (1 + x)) for x, w in zip(POINTS, WEIGHTS, strict=True))
    return 0.5 * p.flywheel * v.crank**2 + rod + energy(p.slider, 1.0)


slider_crank = flexfmu.lagrangian(
    "slider_crank",
    q={"crank": flexfmu.variable(0.0, "rad"), "bend": flexfmu.variable(0.0, "m", nominal=1e-3)},
    rates={"crank": 60.0},
    p={
        "flywheel": flexfmu.variable(0.02, "kg.m2"),
        "rod": flexfmu.variable(0.3, "kg"),
        "slider": flexfmu.variable(0.5, "kg"),
        "stiffness": flexfmu.variable(5e4, "N/m"),
    },
    kinetic=kinetic,
    potential=lambda q, p: 0.5 * p.stiffness * q.bend**2,
    outputs={
        "slider.position": flexfmu.variable(lambda q: point(q, 1.0)[0], "m"),
        "energy": flexfmu.variable(lambda q, v, p: kinetic(q, v, p) + 0.5 * p.stiffness * q.bend**2, "J"),
    },
)

if __name__ == "__main__":
    for stiffness in (2e4, 5e4, 1e6):
        machine = flexfmu.slave(slider_crank, parameters={"stiffness": stiffness})
        run = flexfmu.simulate([machine], stop_time=1.0, step=1e-3, tolerance=1e-8).recording
        energy = run["slider_crank.energy"].values
        bend = abs(run["slider_crank.bend"].values).max()
        drift = abs(energy - energy[0]).max() / energy[0]
        print(f"{stiffness:8.0f} N/m: the rod bends by {1e3 * bend:.3f} mm, energy drifts by {drift:.0e}")
