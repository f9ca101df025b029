"""The flexible slider-crank of the test set for initial value problems, beside its published solution.

Simeon, Modelling a flexible slider crank mechanism by a mixed system of DAEs and PDEs, Math. Modelling of Systems 2 (1996); Mazzia and
Magherini, Test Set for IVP Solvers, Bari, problem II-19. There it has 24 unknowns and index 2; here the crank turns at a given speed and the
loop is closed by hand, so that the four elastic coordinates of the rod are left: two of bending, two of stretching.

python own_ivp_slider_crank.py
"""

import casadi
import numpy as np

import flexfmu

CRANK, ROD, SPEED, PI = 0.15, 0.3, 150.0, 3.1415927  # lengths [m], [rad/s], pi as there
ROD_MASS, SLIDER_MASS, CRANK_INERTIA, ROD_INERTIA = 0.151104, 0.075552, 0.002727, 0.0045339259  # [kg], [kg.m2]
WIDTH, DENSITY, MODULUS = 0.008, 7870.0, 2e11  # of the rod: [m], [kg/m3], [Pa]

# the rod's finite elements: masses, stiffnesses, and what couples them with its motion as a whole
MASS = DENSITY * WIDTH**2 * ROD
MASSES = MASS * np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 8, 1], [0, 0, 1, 2]])
BENDING = PI**4 / 24 * (WIDTH / ROD) ** 2
STIFFNESS = np.array([[BENDING, 0, 0, 0], [0, 16 * BENDING, 0, 0], [0, 0, 16 / 3, -8 / 3], [0, 0, -8 / 3, 7 / 3]])
ALONG, ACROSS = MASS * np.array([0, 0, 2 / 3, 1 / 6]), MASS * np.array([2 / PI, 0, 0, 0])
STRETCH, TURN = MASS * ROD * np.array([0, 0, 1 / 3, 1 / 6]), MASS * ROD * np.array([1, -0.5, 0, 0]) / PI
UPPER = np.zeros((4, 4))
UPPER[0, 2:], UPPER[1, 3] = [-16 / PI**3, 8 / PI**3 - 1 / PI], 0.5 / PI
COUPLING = MASS * (UPPER - UPPER.T)

# start of each coordinate and rate, and both at 0.1 s as published
START = {"q[1]": 0.0, "q[2]": 0.0, "q[3]": 1.03339863e-5, "q[4]": 1.69327969e-5}
RATES = {
    "q[1]": 0.4448961125815990,
    "q[2]": 4.634339319238670e-3,
    "q[3]": -1.785910760000550e-6,
    "q[4]": -2.68938671997904e-6,
}
PUBLISHED = {
    "rod.angle": -0.3311734988256260, "slider.position": 0.1697373328427860,
    "q[1]": 1.893192899613509e-4, "q[2]": 2.375751249879174e-5, "q[3]": -5.323896770569702e-6, "q[4]": -8.363313279112129e-6,
    "der(q[1])": -3.005541400289738e-2, "der(q[2])": -5.500431812571696e-3,
    "der(q[3])": 4.974111734266989e-4, "der(q[4])": 1.105560003626645e-3,
}  # fmt: skip


def places(q, t):
    """Angles of crank and rod, and the slider's position; it stays on the x axis."""
    crank, length = SPEED * t, ROD + q["q[4]"]
    rod = casadi.asin(-CRANK * casadi.sin(crank) / length)
    return casadi.vertcat(crank, rod, CRANK * casadi.cos(crank) + length * casadi.cos(rod))


def kinetic(q, v, t):
    """Of crank and rod as a whole, the slider, the rod's deformation, and what couples them."""
    place, bend, rate = places(q, t), casadi.vertcat(*q), casadi.vertcat(*v)
    crank, rod, slider = casadi.vertsplit(casadi.jtimes(place, casadi.vertcat(bend, t), casadi.vertcat(rate, 1)))
    sine, cosine = casadi.sin(place[0] - place[1]), casadi.cos(place[0] - place[1])
    inertia = ROD_INERTIA + casadi.bilin(MASSES, bend, bend) + 2 * casadi.dot(STRETCH, bend)
    whole = (CRANK_INERTIA + ROD_MASS * CRANK**2) * crank**2 + inertia * rod**2 + SLIDER_MASS * slider**2
    shared = 0.5 * ROD * ROD_MASS * cosine + casadi.dot(sine * ACROSS + cosine * ALONG, bend)
    pushed = CRANK * crank * (cosine * ACROSS - sine * ALONG) + rod * (TURN - COUPLING @ bend)
    return 0.5 * (whole + casadi.bilin(MASSES, rate, rate)) + CRANK * crank * rod * shared + casadi.dot(pushed, rate)


slider_crank = flexfmu.lagrangian(
    "ivp_slider_crank",
    q={name: flexfmu.variable(value, "m", nominal=1e-3 if name == "q[1]" else 1e-5) for name, value in START.items()},
    rates=RATES,
    kinetic=kinetic,
    potential=lambda q: (
        0.5 * MODULUS * WIDTH**2 / ROD * casadi.bilin(STIFFNESS, casadi.vertcat(*q), casadi.vertcat(*q))
    ),
    outputs={
        "rod.angle": flexfmu.variable(lambda q, t: places(q, t)[1], "rad"),
        "slider.position": flexfmu.variable(lambda q, t: places(q, t)[2], "m"),
    },
)

if __name__ == "__main__":
    run = flexfmu.simulate(slider_crank, stop_time=0.1, step=1e-3, tolerance=1e-10).recording
    for name, published in PUBLISHED.items():
        value = run[f"ivp_slider_crank.{name}"].values[-1]
        print(f"{name:16} {value:18.10e}, published {published:18.10e}, difference {abs(value / published - 1):.0e}")
