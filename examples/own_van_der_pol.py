"""A model of your own from its equations: van der Pol's oscillator, simulated, linearised, and as an FMU for other tools.

python own_van_der_pol.py
"""

import flexfmu

van_der_pol = flexfmu.ode(
    "van_der_pol",
    x={"x0": 2.0, "x1": 0.0},
    p={"mu": 1.0},
    rhs=lambda x, p: [x.x1, p.mu * (1 - x.x0**2) * x.x1 - x.x0],
    outputs={"energy": lambda x: 0.5 * (x.x0**2 + x.x1**2)},
)

if __name__ == "__main__":
    # other parameters and starts are values of the same FMU
    for mu in (0.1, 1.0, 5.0):
        oscillator = flexfmu.slave(van_der_pol, "oscillator", parameters={"mu": mu, "start.x0": 1.0})
        run = flexfmu.simulate([oscillator], stop_time=100.0, step=0.05, tolerance=1e-8).recording
        late = run.time > 50.0
        print(f"mu {mu}: amplitude {run['oscillator.x0'].values[late].max():.4f}")

    # about its equilibrium it leaves the circle: the poles have positive real parts
    poles = flexfmu.linearize(van_der_pol, {"x0": 0.0, "x1": 0.0}).poles()
    print(f"poles at the equilibrium: {poles[0]:.3f}, {poles[1]:.3f}")

    path = flexfmu.build(van_der_pol, "van_der_pol.fmu", step=0.05, stop_time=20.0)
    print(f"wrote {path}, for co-simulation and model exchange")
