"""A ball that bounces, and lies still from when it is slow: events reset its states; their instants are those of the closed form.

python own_bouncing_ball.py
"""

import casadi
import numpy as np

import flexfmu

G, SLOW = 9.81, 0.05  # gravity [m/s2], speed behind a bounce from which on the ball lies still [m/s]


def bounce(x, p):
    """States behind a bounce; bounces that go on for ever, in ever shorter time, would end the run with an error."""
    speed = -p.restitution * x.speed
    rests = casadi.if_else(speed < SLOW, 1.0, 0.0)
    return {"height": 0.0, "speed": speed * (1 - rests), "rests": rests, "bounces": x.bounces + 1, "last": x.clock}


# what only events change are states with the rate 0
ball = flexfmu.ode(
    "ball",
    x={
        "height": flexfmu.variable(1.0, "m"),
        "speed": flexfmu.variable(0.0, "m/s"),
        "clock": flexfmu.variable(0.0, "s"),
        "last": flexfmu.variable(0.0, "s", description="Instant of the last bounce"),
        "bounces": 0.0,
        "rests": 0.0,
    },
    p={"restitution": 0.8},
    rhs=lambda x: [x.speed, -G * (1 - x.rests), 1.0, 0.0, 0.0, 0.0],
    events={"bounce": flexfmu.event(lambda x: x.height, -1, bounce)},
)

if __name__ == "__main__":
    run = flexfmu.simulate(ball, stop_time=6.0, step=0.05, tolerance=1e-9)
    count, last = (run.recording[f"ball.{name}"].values for name in ("bounces", "last"))
    # the first fall, then twice the rise after each bounce
    fall = np.sqrt(2 / G)
    exact = [0.0, *fall * (1 + 2 * np.cumsum([0.0, *0.8 ** np.arange(1, count[-1])]))]
    error = max(abs(instant - exact[int(number)]) for number, instant in zip(count, last, strict=True))
    print(f"{count[-1]:.0f} bounces until {last[-1]:.4f} s, their instants within {error:.0e} s; {run.message}")
