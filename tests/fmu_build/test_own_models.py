"""Models from equations: their motions against tight references, what tools say of their FMUs, and errors of bad input."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import casadi
import control
import fmpy
import numpy as np
import pytest
from command_line import flexfmu as run_command
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import flexfmu
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.codegen import generate_functions
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.own_entries import rate_unit
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.symbolic import SymbolicModel

GRAVITY = 9.81

Rates = Callable[[float, Any], Any]


def van_der_pol(mu: float = 1.0) -> SymbolicModel:
    """The oscillator of van der Pol."""
    rhs = lambda x, u, p: [x.x1, p.mu * (1 - x.x0**2) * x.x1 - x.x0]  # noqa: E731
    return flexfmu.ode("vdp", x={"x0": 2.0, "x1": flexfmu.variable(0.0, nominal=mu)}, p={"mu": mu}, rhs=rhs)


def robertson() -> SymbolicModel:
    """Robertson's reactions, by a dict and by expressions of symbols with the states' names."""
    a, b, c = (casadi.SX.sym(name) for name in "abc")
    slow, fast, faster = 0.04 * a, 1e4 * b * c, 3e7 * b**2
    rates = {"c": faster, "a": fast - slow, "b": slow - fast - faster}
    return flexfmu.ode("robertson", x={"a": 1.0, "b": flexfmu.variable(0.0, nominal=3e-5), "c": 0.0}, rhs=rates)


def lotka() -> SymbolicModel:
    """Prey and predators; their invariant is an output."""
    return flexfmu.ode(
        "lotka",
        x={"prey": 1.0, "predators": 1.0},
        p={"b": 1.5, "d": 3.0},
        rhs=lambda x, p: [x.prey * (p.b - x.predators), x.predators * (x.prey - p.d)],
        outputs={
            "invariant": lambda x, p: x.prey - p.d * casadi.log(x.prey) + x.predators - p.b * casadi.log(x.predators)
        },
    )


def cart_pole(**changes: Any) -> SymbolicModel:
    """A pole on a cart, from its energies."""
    equations: dict[str, Any] = {
        "q": {"x": flexfmu.variable(0.0, "m"), "theta": flexfmu.variable(0.5, "rad")},
        "p": {"m": 1.0, "cart": 2.0, "l": 0.5},
        "derived": {"ml": lambda p: p.m * p.l},
        "u": {"force": flexfmu.variable(0.3, "N")},
        "kinetic": lambda q, v, p: (
            0.5 * (p.cart + p.m) * v.x**2 + p.ml * casadi.cos(q.theta) * v.x * v.theta + 0.5 * p.ml * p.l * v.theta**2
        ),
        "potential": lambda q, p: GRAVITY * p.ml * casadi.cos(q.theta),
        "forces": lambda u: {"x": u.force},
    }
    return flexfmu.lagrangian("cart", **(equations | changes))


def cart_pole_rates(t: float, s: Any) -> Any:
    """The same by hand."""
    mass = np.array([[3.0, 0.5 * np.cos(s[1])], [0.5 * np.cos(s[1]), 0.25]])
    loads = np.array([0.3 + 0.5 * np.sin(s[1]) * s[3] ** 2, GRAVITY * 0.5 * np.sin(s[1])])
    return [s[2], s[3], *np.linalg.solve(mass, loads)]


def forced() -> SymbolicModel:
    """A driven oscillator with a rate at the start; its equations have the time and the other sign."""
    return flexfmu.second_order(
        "forced",
        q={"y": flexfmu.variable(0.0, "m")},
        rates={"y": 1.0},
        p={"w": 3.0},
        residual=lambda q, v, a, p, t: [casadi.sin(p.w * t) - a.y - 0.1 * v.y - 4 * q.y],
    )


def pendulum() -> SymbolicModel:
    """A pendulum with its rod force as the variable of a constraint, which is linear in it."""
    return flexfmu.dae(
        "pendulum",
        x={"x": 1.0, "y": 0.0, "vx": 0.0, "vy": 0.0},
        z={"force": 0.0},
        rhs=lambda x, z: [x.vx, x.vy, -z.force * x.x, -z.force * x.y - GRAVITY],
        constraints=lambda x, z: x.vx**2 + x.vy**2 - z.force * (x.x**2 + x.y**2) - GRAVITY * x.y,
    )


def pendulum_rates(t: float, s: Any) -> Any:
    """The same by hand."""
    force = (s[2] ** 2 + s[3] ** 2 - GRAVITY * s[1]) / (s[0] ** 2 + s[1] ** 2)
    return [s[2], s[3], -force * s[0], -force * s[1] - GRAVITY]


def leak() -> SymbolicModel:
    """A tank whose outflow follows from a cubic."""
    return flexfmu.dae(
        "leak", x={"x": 1.0}, z={"w": 0.5}, rhs=lambda z: -z.w, constraints=lambda x, z: z.w**3 + z.w - 2 * x.x
    )


def leak_rates(t: float, s: Any) -> Any:
    """The same with a root finder."""
    return [-float(brentq(lambda w: w**3 + w - 2 * s[0], -10.0, 10.0, xtol=1e-15))]


def source_voltage(t: Any, side: Any) -> Any:
    """A voltage that drops by 8 V at 13 ms [V]."""
    return 5.0 * casadi.cos(500.0 * t) - 4.0 * (1.0 + side)


def rectifier(**guess: Any) -> SymbolicModel:
    """A source, a resistor and a diode, whose current grows 1e9 times within a volt; behind another resistor a capacitor."""
    return flexfmu.dae(
        "rectifier",
        x={"uc": 0.1},
        z={"ud": 0.0, "i": flexfmu.variable(0.0, "A", nominal=1e-3), "w": 0.1} | guess,
        p={"k": 0.0},
        rhs=lambda x, z: (z.ud - x.uc) / 2.2e-3,
        constraints=lambda x, z, p, t, s: [
            z.i - 1e-12 * (casadi.exp(z.ud / 0.05) - 1),
            (source_voltage(t, s.drop) - z.ud) / 1e3 - z.i - (z.ud - x.uc) / 2.2e3,
            z.w**2 - 1 + p.k * t,
        ],
        events={"drop": flexfmu.event(lambda t: t - 0.013)},
    )


def diode_voltage(t: float, uc: float, side: float) -> float:
    """Its ``ud`` by a root finder [V]."""
    rest = float(source_voltage(t, side)) + uc / 2.2
    return float(brentq(lambda ud: 1e-9 * (np.exp(ud / 0.05) - 1) - rest + ud * 3.2 / 2.2, -15, 1.4, xtol=1e-15))


def test_steep_constraints_are_solved_from_far_guesses_and_behind_jumps() -> None:
    """To the tolerance's order; the variables of constraints that have no solution any more are named."""
    times, uc = np.linspace(0.0, 0.02, 201), []
    for side, span in ((-1.0, times[:131]), (1.0, times[130:])):
        rates = lambda t, x, side=side: [(diode_voltage(t, x[0], side) - x[0]) / 2.2e-3]  # noqa: E731
        options = {"rtol": 1e-9, "atol": 1e-10, "max_step": 1e-4}
        found = solve_ivp(rates, span[[0, -1]], [uc[-1] if uc else 0.1], "DOP853", span, **options)
        uc[-1:] = found.y[0]
    ud = [diode_voltage(t, u, side) for t, u, side in zip(times, uc, 2.0 * (times > 0.01301) - 1, strict=True)]
    for guess in ({"ud": 0.6}, {"ud": 1.2, "i": 3.5e-3}, {"ud": 2.0}, {}):
        model = rectifier(**guess)
    # in the equations from any guess within 0.4 V of the solution
    rng, n = np.random.default_rng(0), model.degrees_of_freedom
    start = model.functions["initial_coordinates"]([each.start for each in model.parameters]).full().ravel()
    d = model.functions["derive"]([each.start for each in model.parameters]).full().ravel()
    for t in rng.uniform(0.0, 0.02, 200):
        d[-1] = side = 1.0 if t > 0.013 else -1.0
        solution, (y, v) = diode_voltage(t, 0.5, side), np.split(start.copy(), 2)
        near = solution + rng.uniform(-0.4, 0.4)
        y[-1], v[:3] = t, [0.5, near, 1e-12 * (np.exp(near / 0.05) - 1)]
        rate = model.functions["residual"](y, v, np.zeros(n), [], d).full()[0, 0]
        assert rate == pytest.approx((0.5 - solution) / 2.2e-3, rel=1e-7)
    # a source that turns far faster than the time's size of 1 s
    fast = flexfmu.dae(
        "fast",
        x={"uc": 0.0},
        z={"ud": 0.0},
        rhs=lambda x, z, t: [1e3 * (5 * casadi.sin(3e4 * t) - z.ud - x.uc)],
        constraints=lambda x, z, t: 1e-10 * (casadi.exp(z.ud / 0.025) - 1) - 5 * casadi.sin(3e4 * t) + z.ud + x.uc,
    )
    assert flexfmu.simulate(fast, stop_time=1e-3, step=1e-4).error is None
    run = flexfmu.simulate(model, stop_time=0.02, step=1e-4, tolerance=1e-9)
    for name, expected in (("uc", uc), ("ud", ud)):
        difference = np.delete(run.recording[f"rectifier.{name}"].values - expected, 130)
        assert abs(difference).max() < 2e-8, name
    run = flexfmu.simulate([flexfmu.slave(model, parameters={"k": 70.0})], stop_time=0.02, step=1e-4)
    assert "the iteration of the constraints for ud, i, w fails" in run.message
    assert run.recording.time[-1] == pytest.approx(1 / 70, abs=1e-4)


SIZE = 42
"""States of `network`, whose mass matrix has so many zeros that they are written by a loop."""
COUPLED = np.zeros((SIZE, SIZE))
"""A matrix of the states of `network`, of which each is coupled with a few others drawn, in one direction."""
_RANDOM = np.random.default_rng(3)
COUPLED[np.arange(SIZE), np.arange(SIZE)] = -(10.0 ** _RANDOM.uniform(-1, 2, SIZE))
for _row in range(SIZE):
    COUPLED[_row, _RANDOM.choice(SIZE, 2)] += _RANDOM.uniform(-2.0, 2.0, 2)


def network() -> SymbolicModel:
    """Fast and slow states with drawn couplings: the matrices are sparse and not symmetric."""
    rates = lambda x, t: [casadi.sin(t) + casadi.dot(casadi.SX(row), casadi.vertcat(*x)) for row in COUPLED]  # noqa: E731
    return flexfmu.ode("network", x={f"x{k}": 1.0 for k in range(SIZE)}, rhs=rates)


def chain() -> SymbolicModel:
    """Ten masses in a row, with hardening springs and without damping."""

    def residual(q: Any, a: Any) -> list[Any]:
        stretch = [right - left for left, right in pairwise([0.0, *q, 0.0])]
        forces = [s + s**3 for s in stretch]
        return [each + left - right for each, left, right in zip(a, forces, forces[1:], strict=False)]

    return flexfmu.second_order("chain", q={f"q{k}": 1.0 if k == 0 else 0.0 for k in range(10)}, residual=residual)


def chain_rates(t: float, s: Any) -> Any:
    """The same by hand."""
    stretch = np.diff([0.0, *s[:10], 0.0])
    return [*s[10:], *np.diff(stretch + stretch**3)]


CASES: Mapping[str, tuple[Callable[[], SymbolicModel], Rates, list[float], float, list[str]]] = {
    "vdp": (van_der_pol, lambda t, s: [s[1], (1 - s[0] ** 2) * s[1] - s[0]], [2, 0], 20.0, ["x0", "x1"]),
    "robertson": (
        robertson,
        lambda t, s: [
            1e4 * s[1] * s[2] - 0.04 * s[0],
            0.04 * s[0] - 1e4 * s[1] * s[2] - 3e7 * s[1] ** 2,
            3e7 * s[1] ** 2,
        ],
        [1, 0, 0],
        40.0,
        ["a", "b", "c"],
    ),
    "lotka": (lotka, lambda t, s: [s[0] * (1.5 - s[1]), s[1] * (s[0] - 3.0)], [1, 1], 20.0, ["prey", "predators"]),
    "cart": (cart_pole, cart_pole_rates, [0, 0.5, 0, 0], 3.0, ["x", "theta", "der(x)", "der(theta)"]),
    "forced": (forced, lambda t, s: [s[1], np.sin(3 * t) - 0.1 * s[1] - 4 * s[0]], [0, 1], 10.0, ["y", "der(y)"]),
    "pendulum": (pendulum, pendulum_rates, [1, 0, 0, 0], 3.0, ["x", "y", "vx", "vy"]),
    "leak": (leak, leak_rates, [1], 5.0, ["x"]),
    "network": (network, lambda t, s: COUPLED @ s + np.sin(t), [1] * SIZE, 3.0, [f"x{k}" for k in range(SIZE)]),
    "chain": (chain, chain_rates, [1, *[0] * 19], 10.0, [n.format(k) for n in ("q{}", "der(q{})") for k in range(10)]),
}
"""Model, its rates by hand, start, end [s], outputs that show the states."""

POINTS = 50


@pytest.mark.parametrize("case", CASES)
def test_motion_is_that_of_the_equations(case: str) -> None:
    """In co-simulation to the tolerance times what the problem makes of it; `flexfmu validate` finds nothing; fmpy's CVODE, by model
    exchange, gets the same."""
    make, rates, start, end, names = CASES[case]
    model = make()
    path = build_fmu(model, step=end / POINTS, stop_time=end).path
    method = "Radau" if case == "robertson" else "DOP853"
    reference = solve_ivp(rates, (0, end), start, method=method, rtol=1e-12, atol=1e-15, dense_output=True).sol
    errors = []
    for tolerance in (1e-5, 1e-9):
        run = flexfmu.simulate(path, stop_time=end, step=end / POINTS, tolerance=tolerance).recording
        slave = path.stem if f"{path.stem}.{names[0]}" in run else run.names[0].partition(".")[0]
        values = np.array([run[f"{slave}.{name}"].values for name in names])
        exact = reference(np.asarray(run.time))
        errors.append((abs(values - exact).max(axis=1) / abs(exact).max(axis=1)).max())
    assert errors[0] < 1e-3
    assert errors[1] < 1e-7
    # other tools
    assert validate_fmu(path) == []
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-8,
        stop_time=end,
        output_interval=end / POINTS,
        output=names,
        fmi_call_logger=None,
    )
    exact = reference(found["time"])
    for name, row in zip(names, exact, strict=True):
        assert abs(found[name] - row).max() < 1e-3 * abs(row).max()


def ball() -> SymbolicModel:
    """A ball that bounces."""
    bounce = flexfmu.event(lambda q: q.height, -1, lambda v, p: {"der(height)": -p.e * v.height})
    return flexfmu.second_order(
        "ball",
        q={"height": flexfmu.variable(1.0, "m")},
        p={"e": 0.8},
        residual=lambda a: a.height + GRAVITY,
        events={"bounce": bounce},
    )


def ball_height(t: float) -> float:
    """The same, from bounce to bounce."""
    begin, speed, height = 0.0, 0.0, 1.0
    while (fall := (speed + np.sqrt(speed**2 + 2 * GRAVITY * height)) / GRAVITY) < t - begin:
        begin, speed, height = begin + fall, 0.8 * (GRAVITY * fall - speed), 0.0
    return float(height + speed * (t - begin) - GRAVITY * (t - begin) ** 2 / 2)


def two_springs() -> SymbolicModel:
    """A mass on a spring that is four times as stiff on the negative side: equations take the event's side."""
    return flexfmu.ode(
        "springs",
        x={"x": 1.0, "v": 0.0},
        rhs=lambda x, s: [x.v, -x.x * (1 + 1.5 * (1 - s.wall))],
        events={"wall": flexfmu.event(lambda x: x.x)},
    )


def two_springs_position(t: float) -> float:
    """Half a period of pi, half a period of pi / 2."""
    s = t % (1.5 * np.pi)
    if np.pi / 2 < s < np.pi:
        return float(-0.5 * np.sin(2 * (s - np.pi / 2)))
    return float(np.cos(s) if s <= np.pi / 2 else np.sin(s - np.pi))


def late_ramp() -> SymbolicModel:
    """A ramp that begins at an instant."""
    begin = flexfmu.event(lambda t: t - 0.123)
    return flexfmu.ode("ramp", x={"x": 0.0}, rhs=lambda s: (1 + s.begin) / 2, events={"begin": begin})


def thermostat() -> SymbolicModel:
    """Heating that is switched at 18 and 25 degrees: resets of a state that is the switch."""
    hot, cold = flexfmu.event(lambda x: x.t - 25, 1, {"on": 0.0}), flexfmu.event(lambda x: x.t - 18, -1, {"on": 1.0})
    rhs = {"t": casadi.SX.sym("on") * 3 - (casadi.SX.sym("t") - 10) * 0.1, "on": 0.0}
    return flexfmu.ode("heater", x={"t": 20.0, "on": 1.0}, rhs=rhs, events={"hot": hot, "cold": cold})


def thermostat_temperature(t: float) -> float:
    """Towards 40 and 10 degrees in turn."""
    now, aim, switch = 20.0, 40.0, 25.0
    while (taken := 10 * np.log((now - aim) / (switch - aim))) < t:
        t, now, aim, switch = t - taken, switch, (10.0 if aim == 40.0 else 40.0), (18.0 if aim == 40.0 else 25.0)
    return float(aim + (now - aim) * np.exp(-t / 10))


EVENTS: Mapping[str, tuple[Callable[[], SymbolicModel], Callable[[float], float], float, str]] = {
    "ball": (ball, ball_height, 2.5, "height"),
    "springs": (two_springs, two_springs_position, 10.0, "x"),
    "ramp": (late_ramp, lambda t: max(t - 0.123, 0.0), 1.0, "x"),
    "heater": (thermostat, thermostat_temperature, 60.0, "t"),
}
"""Model, its motion by hand, end [s], output."""


@pytest.mark.parametrize("case", EVENTS)
def test_events_are_met_exactly(case: str) -> None:
    """Between communication points in co-simulation, and by an importer that looks for them."""
    make, motion, end, output = EVENTS[case]
    path = build_fmu(make(), step=end / POINTS, stop_time=end).path
    run = flexfmu.simulate([flexfmu.slave(path, "model")], stop_time=end, step=end / POINTS, tolerance=1e-9).recording
    exact = np.array([motion(t) for t in run.time])
    assert abs(run[f"model.{output}"].values - exact).max() < 1e-7 * abs(exact).max()
    assert validate_fmu(path) == []
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-9,
        stop_time=end,
        output_interval=end / POINTS,
        output=[output],
        record_events=False,
    )
    exact = np.array([motion(t) for t in found["time"]])
    assert abs(found[output] - exact).max() < 1e-5 * abs(exact).max()


DIRECTIONS = {"down": -1, "both": 0, "up": 1}


def jumping() -> SymbolicModel:
    """A level that an instant, another event and an input throw over zero, and that turns at a floor; its passages are counted."""
    count = lambda name: lambda x: {name: getattr(x, name) + 1}  # noqa: E731
    return flexfmu.ode(
        "jumping",
        x={"a": 0.5, "r": -1.0, "b": 0.37, "w": 0.0, "w_floor": 0.0, **dict.fromkeys(DIRECTIONS, 0.0)},
        u={"u": 0.0},
        p={"instant": 0.5, "by_instant": 0.0, "by_event": 0.0},
        rhs=lambda x, s: [x.r, 0.0, -1.0, s.at_both + 2 * s.at_down + 4 * s.at_up, s.floor, 0.0, 0.0, 0.0],
        events={
            "throw": flexfmu.event(lambda t, p: t - p.instant, 1, lambda x, p: {"a": x.a + p.by_instant}),
            "clock": flexfmu.event(lambda x: x.b, -1, lambda x, p: {"b": 0.37, "a": x.a + p.by_event}),
            "floor": flexfmu.event(lambda x: x.a + 0.7, -1, lambda x: {"r": -x.r}),
            **{f"at_{each}": flexfmu.event(lambda x, u: x.a + u.u, d, count(each)) for each, d in DIRECTIONS.items()},
        },
    )


def jumping_by_hand(p: Mapping[str, float], u: np.ndarray[Any, Any]) -> list[float]:
    """Integrals of its sides, and its counts, after 1 s: straight lines between instants, signs behind jumps."""
    a, r, b, t, k = p["start.a"], p["start.r"], 0.37, 0.0, 0
    sides, integrals, counts = np.sign([a + u[0], a + 0.7]), np.zeros(2), dict.fromkeys(DIRECTIONS, 0)
    while True:
        numbers = np.array([a + u[k], a + 0.7])
        passes = [abs(g / r) if side * r < 0.0 else np.inf for g, side in zip(numbers, sides, strict=True)]
        waits = [*passes, p["instant"] - t if t < p["instant"] else np.inf, b, (k + 1) / len(u) - t]
        kind, h = int(np.argmin(waits)), min(waits)
        t, a, b, integrals = t + h, a + r * h, b - h, integrals + h * sides
        if kind == 4 and k + 1 == len(u):
            return [7 * integrals[0], integrals[1], *counts.values()]
        k += kind == 4
        a += p["by_instant"] * (kind == 2) + p["by_event"] * (kind == 3)
        t, b = p["instant"] if kind == 2 else t, 0.37 if kind == 3 else b
        behind = np.sign([a + u[k], a + 0.7]) if kind > 1 else np.where([kind == 0, kind == 1], np.sign(r), sides)
        if behind[0] != sides[0]:
            for each, d in DIRECTIONS.items():
                counts[each] += d * behind[0] >= 0
        if behind[1] < sides[1]:
            # at the floor the motion turns, and stays on its side unless it was thrown there
            r, behind[1] = -r, 1.0 if kind == 1 else -1.0
        sides = behind


@pytest.mark.slow
def test_passages_by_jumps_count(tmp_path: Path) -> None:
    """Sides are the signs of numbers behind a jump, whatever makes it and wherever the number then goes."""
    random, model, names = np.random.default_rng(5), jumping(), ["w", "w_floor", *DIRECTIONS]
    for fmi in ("2", "3"):
        path = build_fmu(model, step=0.1, stop_time=1.0, fmi=fmi).path
        unpacked = fmpy.extract(str(path), str(tmp_path / fmi))
        description = fmpy.read_model_description(unpacked)
        for fmi_type in 10 * ("CoSimulation", "ModelExchange"):
            start = {"start.a": random.uniform(-0.6, 1), "start.r": random.choice([-1, 1]) * random.uniform(0.2, 3.0)}
            jumps = {each: random.uniform(-1.0, 1.0) for each in ("by_instant", "by_event")}
            p, u = {**start, **jumps, "instant": random.uniform(0.1, 0.9)}, random.uniform(-0.6, 0.6, 5)
            signal = [(t, value) for k, value in enumerate(u) for t in (k / 5, (k + 1) / 5)]
            found = fmpy.simulate_fmu(
                unpacked, model_description=description, fmi_type=fmi_type, stop_time=1.0, step_size=0.1, output_interval=0.1,
                relative_tolerance=1e-8, start_values=p, output=names, fmi_call_logger=None,
                input=np.array(signal, dtype=[("time", float), ("u", float)])
            )  # fmt: skip
            assert [found[each][-1] for each in names] == pytest.approx(jumping_by_hand(p, u), abs=1e-6), (p, u)


@flexfmu.controller(sample_time=0.07, offset=0.03, inputs=["x"], outputs=["u"], state=0.5)
def integral(measurement: Any, state: Any, *, gain: float = 2.0) -> Any:
    """Proportional and integral feedback."""
    return [state[0] - gain * measurement[0]], [state[0] - 0.07 * measurement[0]]


@flexfmu.controller(sample_time=0.1, inputs=["t"], outputs=["instant"])
def watch(measurement: Any) -> Any:
    """The time at which it samples."""
    return measurement[0]


def sampled() -> SymbolicModel:
    """A first-order lag with its sampled controller, and a part that tells when it samples."""
    return flexfmu.ode(
        "sampled",
        x={"x": 1.0},
        rhs=lambda x: x["pi.u"] - x.x,
        parts={"pi": flexfmu.part(integral, lambda x: [x.x]), "watch": flexfmu.part(watch, lambda t: [t])},
    )


def sampled_state(t: float) -> float:
    """The same from sample to sample."""
    x, u, state, last = 1.0, 0.0, 0.5, 0.0
    for instant in 0.03 + 0.07 * np.arange(np.floor((t - 0.03) / 0.07 + 1e-9) + 1):
        x, last = u + (x - u) * np.exp(last - instant), instant
        u, state = state - 2.0 * x, state - 0.07 * x
    return float(u + (x - u) * np.exp(last - t))


def test_parts_sample_at_their_instants() -> None:
    """To rounding, whatever the communication step; in model exchange they are time events; FMI 3.0 has the same bits."""
    model, recordings = sampled(), []
    versions: tuple[Literal[2, "3"], ...] = (2, "3")  # numbers too
    for fmi in versions:
        path = build_fmu(model, step=0.11, stop_time=2.2, fmi=fmi).path
        assert fmi == "3" or validate_fmu(path) == []
        slave = flexfmu.slave(path, "model")
        recordings.append(flexfmu.simulate([slave], stop_time=2.2, step=0.11, tolerance=1e-10).recording)
    time, found = recordings[0].time, recordings[0]["model.x"].values
    assert np.array_equal(found, recordings[1]["model.x"].values)
    assert np.allclose(found, [sampled_state(t) for t in time], atol=1e-9)
    instants = 0.1 * np.floor(time / 0.1 + 1e-9)
    assert abs(recordings[0]["model.watch.instant"].values - instants).max() < 1e-14
    exchanged = fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, stop_time=2.2, output_interval=0.11,
        output=["x", "watch.instant"], record_events=False
    )  # fmt: skip
    assert np.allclose(exchanged["x"], [sampled_state(t) for t in exchanged["time"]], atol=1e-6)
    assert abs(exchanged["watch.instant"] - 0.1 * np.floor(exchanged["time"] / 0.1 + 1e-9)).max() < 1e-14


def test_bounces_that_accumulate_end_a_run() -> None:
    """With the reason, where they do: after nine times the first fall."""
    found = flexfmu.simulate(ball(), stop_time=10.0, step=0.05)
    assert "an event (bounce) follows itself in ever shorter time" in found.message
    assert repr(found).startswith(f"Simulation failed after {found.steps} steps: ball failed: ")
    # so does a switch along whose zero the motion slides
    events = {"side": flexfmu.event(lambda x: x.x)}
    slide = flexfmu.ode(
        "slide", x={"x": 0.1, "y": 1.0}, p={"k": 0.0}, rhs=lambda x, p, s: [-s.side, p.k * x.y], events=events
    )
    # and what grows until its square overflows
    grown = flexfmu.simulate([flexfmu.slave(slide, parameters={"k": 1e4})], stop_time=0.05, step=0.01)
    assert re.search(r"at 0\.0355\d* s the model gives no finite number", grown.message)
    assert "one of these events happens again at once: side" in flexfmu.simulate(slide, stop_time=1.0, step=1.0).message
    assert found.recording.time[-1] == pytest.approx(9 * np.sqrt(2 / GRAVITY), abs=0.05)


def test_friction_sticks_on_a_belt() -> None:
    """A mass on a spring, carried by a belt until the spring exceeds the breakaway force, slips back and sticks again."""
    model = flexfmu.second_order(
        "belt",
        q={"slip": 0.0},
        p={"k": 100.0, "belt": 0.1},
        residual=lambda q, v, a, p, t: -a.slip - p.k * (q.slip + p.belt * t),
        friction={"slip": (10.0, lambda: 6.0)},
    )
    run = flexfmu.simulate(model, stop_time=2.5, step=0.01, tolerance=1e-9).recording
    slip, before = run["belt.slip"].values, run.time < 1.0
    assert abs(slip[before]).max() == 0.0
    # slipping, it swings about 0.06 m until it has the belt's speed again, 0.08 m back
    swing = np.pi + 2 * np.arctan2(0.01, 0.04)
    assert -slip[run.time == 2.0] == pytest.approx(0.08 + 0.1 * swing / 10, rel=1e-8)


def test_what_is_conserved_stays() -> None:
    """The populations' invariant, and what reacts, to the tolerance."""
    run = flexfmu.simulate(lotka(), stop_time=50.0, step=0.5, tolerance=1e-9).recording
    assert np.ptp(run["lotka.invariant"].values) < 1e-6
    run = flexfmu.simulate(robertson(), stop_time=1e5, step=1e4).recording
    assert np.allclose(sum(run[f"robertson.{name}"].values for name in "abc"), 1.0, atol=1e-8)


def test_starts_are_parameters_of_the_fmu() -> None:
    """A built FMU runs from elsewhere; a tight tolerance is relative to nominals, or to what has been reached."""
    half = flexfmu.slave(van_der_pol(), "half", parameters={"start.x0": 0.5, "mu": 0.0, "start.x1": 0.0})
    run = flexfmu.simulate([half], stop_time=6.0, step=0.1, tolerance=1e-8).recording
    assert np.allclose(run["half.x0"].values, 0.5 * np.cos(run.time), atol=1e-7)


def test_code_grows_with_entries_not_with_their_square() -> None:
    """Zeros of a mass matrix take no lines, which compilers would work on for minutes."""
    functions, _ = generate_functions(network())
    assert functions["model_mass_matrix.c"].count("\n") < 2 * SIZE


@pytest.mark.parametrize("case", ["vdp", "lotka", "network", "chain"])
def test_lanes_are_runs_one_by_one(case: str) -> None:
    """Variants of a start value side by side in the processor's lanes move as the equations say."""
    make, rates, start, end, names = CASES[case]
    scales, time = np.linspace(0.5, 1.5, 9), np.linspace(0.0, end, POINTS + 1)
    starts = {f"start.{names[0]}": scales * start[0]}
    result = flexfmu.sweep(make(), starts, record=names, stop_time=end, step=end / POINTS, tolerance=1e-9)
    assert not result.failed
    for k, scale in enumerate(scales):
        exact = solve_ivp(
            rates, (0, end), [scale * start[0], *start[1:]], method="DOP853", rtol=1e-12, atol=1e-14, t_eval=time
        ).y
        found = np.array([result.recording(k)[name].values for name in names])
        assert abs(found - exact).max() < 1e-6 * abs(exact).max()


def test_variants_with_events_go_one_by_one() -> None:
    """Those that fail have a message and don't disturb the others; what isn't given has its start value."""
    result = flexfmu.sweep(ball(), [{"e": 0.8}, {"e": 0.1}, {}], record=["height"], stop_time=2.0, step=0.1)
    for k in (0, 2):
        assert result.recording(k)["height"].values[-1] == pytest.approx(ball_height(2.0), abs=1e-6)
    assert [row["case"] for row in result.failed] == [1]
    assert "follows itself in ever shorter time" in result.failed[0]["message"]


def test_linearised_about_a_point() -> None:
    """The upright cart-pole has its textbook's poles, a state of first order its own, and other points those of differences."""
    system = flexfmu.linearize(cart_pole(), {"theta": 0.0, "force": 0.0}, ["theta"])
    assert list(system.state_labels) == ["x", "theta", "der(x)", "der(theta)"]
    assert sorted(system.poles().real)[-1] == pytest.approx(np.sqrt(GRAVITY * 3.0 / (2.0 * 0.5)))
    assert repr(cart_pole()) == "Model cart: unknowns x, theta; inputs force; 6 outputs"
    oscillator = flexfmu.linearize(van_der_pol(2.0), {"x0": 0.3, "x1": 0.7}, ["x1"])
    assert np.allclose(oscillator.A, [[0, 1], [-1 - 4 * 0.3 * 0.7, 2 * (1 - 0.09)]])
    assert list(oscillator.state_labels) == ["x0", "x1"]
    driven = flexfmu.linearize(forced(), {"y": 1.0})
    assert np.allclose(driven.A, [[0, 1], [-4, -0.1]])
    with pytest.raises(ModelError, match="no state or input 'phi'"):
        flexfmu.linearize(cart_pole(), {"phi": 0.0})
    with pytest.raises(flexfmu.InputError, match="by name"):
        flexfmu.linearize(cart_pole(), (0.0, 1.0))


def test_margins_are_those_of_python_control() -> None:
    """Loops of drawn motors with elastic shafts: their margins are where the loop of python-control's sampled plant becomes unstable."""
    rng = np.random.default_rng(0)
    stable = 0
    for seed in range(8):
        load, stiffness, damping, kp, kd = np.exp(rng.uniform(-1.0, 1.0, 5)) * [1.0, 200.0, 0.3, 20.0, 4.0]
        shaft = flexfmu.second_order(
            "shaft",
            q={"motor": 0.1, "load": 0.1},
            u={"torque": flexfmu.variable(0.0, "N.m")},
            residual=lambda q, v, a, u, j=load, k=stiffness, d=damping: [
                a.motor + k * (q.motor - q.load) + d * (v.motor - v.load) - u.torque + 0.1 * casadi.sin(q.motor),
                j * a.load + k * (q.load - q.motor) + d * (v.load - v.motor),
            ],
        )
        pd = control.ss([], [], [], [[-kp, -kd]], 5e-3, inputs=["angle", "rate"], outputs=["torque"])
        sensed = "load" if seed % 3 == 0 else "motor"
        wires = {"shaft.torque": "controller.torque", "controller.angle": f"shaft.{sensed}"}
        wires["controller.rate"] = f"shaft.der({sensed})"
        found = flexfmu.margins([shaft, pd], wires, point={"motor": 0.3, "load": 0.2})
        plant = flexfmu.linearize(shaft, {"motor": 0.3, "load": 0.2}, [sensed, f"der({sensed})"])
        loop = control.sample_system(plant, 5e-3)

        def radius(factor: complex, loop: Any = loop, pd: Any = pd) -> float:
            return float(abs(np.linalg.eigvals(loop.A + factor * loop.B @ pd.D @ loop.C)).max())

        assert found.is_stable == (radius(1.0) < 1.0)
        if not found.is_stable:
            assert found.verdict.startswith("Unstable at the point")
            continue
        stable, worst = stable + 1, found.worst
        gains = [g for g in (worst.gain_margin, worst.gain_reduction) if 0.0 < g < np.inf]
        for critical in (*gains, np.exp(-1j * worst.phase_margin)):
            assert radius(critical) == pytest.approx(1.0, abs=1e-7)
            assert all(radius(complex(critical) ** share) < 1.0 for share in np.linspace(0.0, 0.99, 20))
        response = (-pd * loop).frequency_response(np.geomspace(0.1, np.pi / 5e-3, 2000)).complex
        assert worst.sensitivity_peak == pytest.approx(abs(1 / (1 + response)).max(), rel=2e-3)
    assert 3 < stable < 8
    free = {"shaft.torque": "controller.torque"}
    for message, slaves, connections in (
        ("no sampled controller feeds shaft and is fed by it", [shaft, pd], free),
        ("got 0 models", [pd], {}),
        ("samples inside", [sampled(), pd], {}),
    ):
        with pytest.raises(flexfmu.InputError, match=message):
            flexfmu.margins(slaves, connections)


def test_command_builds_the_model_of_a_file(tmp_path: Path) -> None:
    """`flexfmu build MODEL.py:NAME` and `flexfmu sweep` of it; what isn't a model is named, with those that are."""
    file = tmp_path / "own.py"
    file.write_text(
        'import flexfmu\ndecay = flexfmu.ode("decay", x={"x": 1.0}, p={"k": flexfmu.variable(1.0, minimum=0.0)}, rhs=lambda x, p: -p.k * x.x, '
        'events={"half": flexfmu.event(lambda x: x.x - 0.5)})\nnumber = 1\n',
        encoding="utf-8",
    )
    target = tmp_path / "decay.fmu"
    assert run_command("build", f"{file}:decay", "-o", target).exit_code == 0
    assert flexfmu.simulate(target, stop_time=1.0, step=0.1).recording["decay.x"].values[-1] == pytest.approx(
        np.exp(-1)
    )
    for name in (":number", ":other", ""):
        failed = run_command("build", f"{file}{name}")
        assert failed.exit_code == 2
        assert "is no model; take" in failed.output
        assert "own.py:decay" in failed.output.replace("\n", "")
    assert run_command("build", f"{file}:decay", "--set", "payload.mass=1").exit_code == 2
    sweep = ["sweep", f"{file}:decay", "--vary", "k=1,2,-1", "--out", tmp_path / "sweep", "--no-plot"]
    for refused in ([], ["--stop-time", "1"], ["--stop-time", "1", "--step", "0.1", "--metrics", "x"]):
        assert run_command(*sweep, *refused).exit_code == 2
    command = [*sweep, "--stop-time", "1", "--step", "0.1", "--record", "x"]
    assert run_command(*command).exit_code == 0
    head, first, second, failed = (tmp_path / "sweep" / "sweep.csv").read_text(encoding="utf-8").splitlines()
    assert head == "case,k [1],x.min [1],x.max [1],x.end [1],message"
    for line, rate in ((first, 1.0), (second, 2.0)):
        assert [*map(float, line.split(",")[2:5])] == pytest.approx([np.exp(-rate), 1.0, np.exp(-rate)], rel=1e-6)
    assert failed.startswith("2,-1,,,,")
    # a finished sweep has nothing to do, another one is refused
    assert run_command(*command).exit_code == 0
    assert run_command(*sweep, "--stop-time", "2", "--step", "0.1").exit_code == 2
    file = tmp_path / "wrong.py"
    file.write_text(
        'import flexfmu\nm = flexfmu.ode("m", x={"x": 1.0}, p={"x": 1.0}, rhs=lambda x: -x.x)\n', encoding="utf-8"
    )
    # the line of the user's file, not one of ours
    assert "wrong.py, line 2)" in run_command("build", f"{file}:m").output.replace("\n", "")


GOOD: dict[str, Any] = {"x": {"x": 1.0}, "rhs": lambda x: -x.x}

BAD: list[tuple[str, Callable[[], object]]] = [
    ("rhs of model 'm' gives 2 expressions", lambda: flexfmu.ode("m", x={"x": 1.0}, rhs=lambda x: [x.x, x.x])),
    ("has no 'y'; it has x", lambda: flexfmu.ode("m", x={"x": 1.0}, rhs=lambda x: x.y)),
    ("free symbol 'k'", lambda: flexfmu.ode("m", x={"x": 1.0}, rhs=lambda x: x.x * casadi.SX.sym("k"))),
    ("takes 'w'; it may take", lambda: flexfmu.ode("m", x={"x": 1.0}, rhs=lambda w: w)),
    ("start of x 'x' must be a finite number", lambda: flexfmu.ode("m", **GOOD | {"x": {"x": float("nan")}})),
    ("nominal of x 'x' must be a positive number", lambda: flexfmu.ode("m", **GOOD | {"x": {"x": flexfmu.variable(1.0, nominal=0.0)}})),
    ("model 'm': unit of x 'x': unit 'furlong' isn't known", lambda: flexfmu.ode("m", **GOOD | {"x": {"x": flexfmu.variable(1.0, "furlong")}})),
    ("jumps \\(if_else\\)|jumps \\(<", lambda: flexfmu.ode("m", **GOOD | {"rhs": lambda x: casadi.if_else(x.x > 0, 1, -1)})),
    ("jumps \\(sign\\)", lambda: flexfmu.ode("m", **GOOD | {"rhs": lambda x: casadi.sign(x.x)})),
    ("has the number nan", lambda: flexfmu.ode("m", **GOOD | {"rhs": [float("nan")]})),
    ("gives nothing for 'x'", lambda: flexfmu.ode("m", **GOOD | {"rhs": {}})),
    ("there are no states", lambda: flexfmu.ode("m", x={}, rhs=[])),
    ("MX; use SX", lambda: flexfmu.ode("m", **GOOD | {"rhs": [casadi.MX.sym("x")]})),
    ("ZeroDivisionError", lambda: flexfmu.ode("m", **GOOD | {"rhs": lambda x: x.x / (1 / 0)})),
    ("model 'm': the name 'x' is there more than once", lambda: flexfmu.ode("m", **GOOD, p={"x": 1.0})),
    ("needs one that comes later", lambda: flexfmu.ode("m", **GOOD, derived={"a": lambda p: p.b, "b": lambda p: 1.0})),
    ("isn't symmetric: its entry \\(a, b\\)", lambda: flexfmu.second_order("m", q={"a": 0.0, "b": 0.0}, residual=lambda a: [a.a + a.b, a.b])),
    ("isn't symmetric away from the start: its entry \\(a, b\\)", lambda: flexfmu.second_order("m", q={"a": 0.0, "b": 0.0}, residual=lambda q, a: [a.a + q.a * a.b, a.b])),
    ("compares symbols in Python", lambda: flexfmu.ode("m", **GOOD | {"rhs": lambda x: max(x.x, 0.0)})),
    ("give another guess in z", lambda: flexfmu.dae("m", x={"x": 0.0}, z={"z": 0.0}, rhs=lambda z: z.z, constraints=lambda x, z: z.z**2 - x.x)),
    ("is singular at the start: 'b'", lambda: flexfmu.second_order("m", q={"a": 0.0, "b": 0.0}, residual=lambda q, a: [a.a, q.b])),
    ("is not definite", lambda: flexfmu.second_order("m", q={"a": 0.0, "b": 0.0}, residual=lambda a: [2 * a.a, -a.b])),
    ("must be linear in them", lambda: flexfmu.second_order("m", q={"a": 0.0}, residual=lambda a: a.a**3)),
    ("depends on rates", lambda: flexfmu.second_order("m", q={"a": 0.0}, residual=lambda v, a: a.a * (1 + v.a**2))),
    ("name 'b', which is no coordinate", lambda: flexfmu.second_order("m", q={"a": 0.0}, rates={"b": 0.0}, residual=lambda a: a.a)),
    ("'a b' can't be the name", lambda: flexfmu.ode("m", x={"a b": 1.0}, rhs=[0.0])),
    ("direction of an event is", lambda: flexfmu.event(lambda t: t, 2)),
    ("must be made by flexfmu.event", lambda: flexfmu.ode("m", **GOOD, events={"e": lambda t: t})),
    ("gives a dict of states, of x", lambda: flexfmu.ode("m", **GOOD, events={"e": flexfmu.event(lambda t: t, 0, {"y": 1.0})})),
    ("model 'm': friction is", lambda: flexfmu.second_order("m", q={"a": 0.0}, residual=lambda a: a.a, friction={"b": 1.0})),
    ("index is 2 or 3", lambda: flexfmu.dae("m", x={"x": 1.0}, z={"z": 0.0}, rhs=lambda z: z.z, constraints=lambda x: x.x - 1)),
    ("can't be solved at the start", lambda: flexfmu.dae("m", x={"x": 1.0}, z={"z": 0.1}, rhs=lambda z: z.z, constraints=lambda z: z.z**2 + 1)),
    ("must be at least 0.0, got -1.0$", lambda: flexfmu.ode("m", **GOOD, p={"k": flexfmu.variable(-1.0, minimum=0.0)})),
    ("minimum of p 'k', 2.0 m, is above its maximum, 1.0 m", lambda: flexfmu.ode("m", **GOOD, p={"k": flexfmu.variable(1.0, "m", minimum=2.0, maximum=1.0)})),
    ("start of x 'x' must be a number, got True", lambda: flexfmu.ode("m", **GOOD | {"x": {"x": True}})),
    ("integrator' can't be the name of a variable: ", lambda: flexfmu.ode("m", **GOOD, p={"integrator": 1.0})),
    ("start.a' can't be the name of a variable: ", lambda: flexfmu.ode("m", **GOOD, p={"start.a": 1.0})),
    ("event 'e' of model 'm' is constant", lambda: flexfmu.ode("m", **GOOD, events={"e": flexfmu.event(1.0)})),
    ("got -1 and -1", lambda: flexfmu.second_order("m", q={"a": 0.0}, residual=lambda a: a.a, friction={"a": -1.0})),
    ("got -2 and -2 at the start", lambda: flexfmu.second_order("m", q={"a": 0.0}, p={"f": 2.0}, residual=lambda a: a.a, friction={"a": lambda p: -p.f})),
    ("got 1 and 2", lambda: flexfmu.second_order("m", q={"a": 0.0}, residual=lambda a: a.a, friction={"a": (1.0, 2.0)})),
    ("no sampled controller feeds m", lambda: flexfmu.margins(flexfmu.ode("m", **GOOD))),
    ("is no scene: simulate", lambda: flexfmu.run(flexfmu.ode("m", **GOOD))),  # type: ignore[arg-type]
    ("is no scene: simulate", lambda: flexfmu.modes(flexfmu.ode("m", **GOOD))),  # type: ignore[arg-type]
    ("unit of p 'k': must be a text", lambda: flexfmu.ode("m", **GOOD, p={"k": flexfmu.variable(1.0, None)})),  # type: ignore[arg-type]
    ("'time' can't be the name", lambda: flexfmu.ode("m", **GOOD, u={"time": 1.0})),
    ("there is no argument 'parameters'", lambda: flexfmu.ode("m", **GOOD, parameters={})),  # type: ignore[call-arg]
    ("model 'm': events is a dict", lambda: flexfmu.ode("m", **GOOD, events=[])),  # type: ignore[arg-type]
    ("has no variables z", lambda: flexfmu.dae("m", **GOOD, z={}, constraints=[])),
    ("the name 'x' is there more than once", lambda: flexfmu.ode("m", **GOOD, outputs={"x": 1.0})),
    ("model 'm': unit of output 'y': unit 'furlong' isn't known", lambda: flexfmu.ode("m", **GOOD, outputs={"y": flexfmu.variable(1.0, "furlong")})),
    ("state 'guess.z' of model 'm' can't have", lambda: flexfmu.dae("m", x={"x": 1.0, "guess.z": 1.0}, z={"z": 1.0}, rhs=lambda z: [-z.z, 0], constraints=lambda x, z: z.z**3 - x.x)),
    ("naming is structured or flat, got 'x'", lambda: flexfmu.build("barnard2012-6kg", naming="x")),  # type: ignore[arg-type]
    ("x of the point must be a finite number", lambda: flexfmu.linearize(flexfmu.ode("m", **GOOD), {"x": "a"})),
    ("has no parameter 'k'", lambda: flexfmu.sweep(flexfmu.ode("m", **GOOD), {"k": [1.0]}, stop_time=1.0, step=0.1)),
    ("has no output 'k'", lambda: flexfmu.sweep(flexfmu.ode("m", **GOOD), {"start.x": [1.0]}, record=["k"], stop_time=1.0, step=0.1)),
    ("values of start.x must be numbers", lambda: flexfmu.sweep(flexfmu.ode("m", **GOOD), {"start.x": ["a"]}, stop_time=1.0, step=0.1)),
    ("needs its end and communication step", lambda: flexfmu.sweep(flexfmu.ode("m", **GOOD), {"start.x": [1.0]}, step=0.1)),
    ("metrics is for scenes", lambda: flexfmu.sweep(flexfmu.ode("m", **GOOD), {"start.x": [1.0]}, metrics=["a"], stop_time=1.0, step=0.1)),
    ("are for models from equations", lambda: flexfmu.sweep("barnard2012-6kg", {"payload.mass": [1.0]}, step=1.0)),
    ("model 'm': part 'c' must be flexfmu.part of", lambda: flexfmu.ode("m", **GOOD, parts={"c": watch})),  # type: ignore[dict-item]
    ("inputs of part 'c' of model 'm' gives 2", lambda: flexfmu.ode("m", **GOOD, parts={"c": flexfmu.part(watch, lambda x, t: [x.x, t])})),
    ("'2' for FMI 2.0 or '3' for FMI 3.0, got '3.0'", lambda: flexfmu.build(flexfmu.ode("m", **GOOD), fmi="3.0")),  # type: ignore[arg-type]
    ("'2' for FMI 2.0 or '3' for FMI 3.0, got 1", lambda: flexfmu.build("barnard2012-6kg", fmi=1)),  # type: ignore[arg-type]
    ("is for models from equations", lambda: flexfmu.build("barnard2012-6kg", step=1.0)),
]  # fmt: skip


@pytest.mark.parametrize(("message", "make"), BAD, ids=[text for text, _ in BAD])
def test_bad_input_is_named_in_one_line(message: str, make: Callable[[], object]) -> None:
    """No traceback of CasADi."""
    with pytest.raises(flexfmu.Error, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


THINGS = st.one_of(
    st.none(), st.text(max_size=3), st.floats(), st.integers(-2, 2), st.lists(st.floats(), max_size=3), st.booleans()
)


@settings(max_examples=100, deadline=None)
@given(
    entries=st.dictionaries(st.text(max_size=3), THINGS, max_size=3),
    rhs=st.one_of(THINGS, st.dictionaries(st.text(max_size=3), THINGS)),
)
def test_anything_is_a_model_or_an_error_in_one_line(entries: dict[str, Any], rhs: Any) -> None:
    """Whatever is given as states and their rates, in any of the four forms."""
    for make in (
        lambda: flexfmu.ode("m", x=entries, rhs=rhs, p=entries),
        lambda: flexfmu.second_order("m", q=entries, residual=rhs),
        lambda: flexfmu.lagrangian("m", q=entries, kinetic=rhs, forces=rhs),
        lambda: flexfmu.dae("m", x=entries, z=entries, rhs=rhs, constraints=rhs),
    ):
        with suppress(flexfmu.Error):
            make()


CART = cart_pole()


@settings(max_examples=200)
@given(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4))
def test_lagrange_is_newton_for_any_motion(state: list[float]) -> None:
    """The residual at the accelerations of the cart-pole by hand is zero."""
    s, functions = np.array(state), CART.functions
    derived = functions["derive"]([each.start for each in CART.parameters])
    residual = functions["residual"](s[:2], s[2:], cart_pole_rates(0.0, s)[2:], [0.3], derived).full()
    assert np.allclose(residual, 0.0, atol=1e-9)


@pytest.mark.parametrize(("unit", "rate"), [("1", "1/s"), ("m", "m/s"), ("m/s", "m/s2"), ("rad/s2", "rad/s3"), ("J/(kg.K)", "J/(kg.K.s)")])  # fmt: skip
def test_units_of_rates(unit: str, rate: str) -> None:
    """Per second once more."""
    assert rate_unit(unit) == rate
