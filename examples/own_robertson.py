"""Stiff equations: Robertson's chemical reactions, whose rates differ by nine decades, over eleven decades of time.

python own_robertson.py
"""

import flexfmu


def rates(x, p):
    """Time derivatives of the concentrations of a, b and c."""
    slow, back, fast = p.k1 * x.a, p.k3 * x.b * x.c, p.k2 * x.b**2
    return {"a": back - slow, "b": slow - back - fast, "c": fast}


# the nominal size of b is what its tolerance is relative to
robertson = flexfmu.ode(
    "robertson",
    x={"a": 1.0, "b": flexfmu.variable(0.0, nominal=1e-5), "c": 0.0},
    p={"k1": flexfmu.variable(0.04, "1/s"), "k2": flexfmu.variable(3e7, "1/s"), "k3": flexfmu.variable(1e4, "1/s")},
    rhs=rates,
)

if __name__ == "__main__":
    for decade in range(0, 12, 2):
        run = flexfmu.simulate(robertson, stop_time=10.0**decade, step=10.0**decade).recording
        a, b, c = (run[f"robertson.{name}"].values[-1] for name in "abc")
        print(f"{10.0**decade:8.0e} s: a {a:.4e}, b {b:.4e}, c {c:.6f}, sum - 1 {a + b + c - 1:.0e}")
