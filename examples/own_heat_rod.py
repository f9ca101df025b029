"""A partial differential equation by lines: heat along a rod, heated at one end, with loss to the air, as 40 states.

python own_heat_rod.py
"""

from itertools import pairwise

import numpy as np

import flexfmu

CELLS, LENGTH, AIR = 40, 0.5, 293.15


def rates(x, u, p):
    """Time derivatives of the temperatures, by finite volumes."""
    temperature = list(x)
    flow = [u.power, *(p.conductance * (a - b) for a, b in pairwise(temperature)), 0.0]
    loss = [p.loss / CELLS * (each - AIR) for each in temperature]
    return [(flow[k] - flow[k + 1] - loss[k]) / p.capacity for k in range(CELLS)]


rod = flexfmu.ode(
    "rod",
    x={f"temperature[{k + 1}]": flexfmu.variable(AIR, "K") for k in range(CELLS)},
    p={"conductivity": 200.0, "section": flexfmu.variable(1e-4, "m2"), "heat": 2.4e6, "loss": 0.5},
    derived={
        "conductance": lambda p: p.conductivity * p.section / (LENGTH / CELLS),
        "capacity": lambda p: p.heat * p.section * LENGTH / CELLS,
    },
    u={"power": flexfmu.variable(20.0, "W")},
    rhs=rates,
)

if __name__ == "__main__":
    run = flexfmu.simulate(rod, stop_time=3600.0, step=60.0).recording
    warmth = np.array([run[f"rod.temperature[{k + 1}]"].values for k in range(CELLS)])
    for minute in (1, 5, 60):
        print(
            f"after {minute:2} min: {warmth[0, minute] - AIR:6.2f} K at the heater, {warmth[-1, minute] - AIR:6.2f} K at the end"
        )

    # in the end the loss takes the power, and the profile is that of a fin, here in the middle of the first and last cell
    m = np.sqrt(0.5 / LENGTH / (200.0 * 1e-4))
    exact = (
        20.0 / (200.0 * 1e-4 * m * np.sinh(m * LENGTH)) * np.cosh(m * LENGTH * np.array([1 - 0.5 / CELLS, 0.5 / CELLS]))
    )
    print(f"fin at rest:  {exact[0]:6.2f} K at the heater, {exact[1]:6.2f} K at the end")
