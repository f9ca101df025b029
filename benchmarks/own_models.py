"""Standard problems as models from equations: time of our FMU for the same error as CasADi's CVODES, compiled, with exact Jacobians.

Both integrate from the same expressions to the same points, at tolerances of 1e-3 to 1e-12; the times for an error are interpolated between
these. Errors are the largest of any state at any point, relative to the largest value of the state there; the reference is SciPy's Radau or
DOP853 at 1e-13. Times are processor times of the integration alone, the least of several.

    python benchmarks/own_models.py [--error 1e-6] [--only vdp1000,cart_pole] [--same-tolerance]

With ``--same-tolerance`` it prints our error divided by that of CVODES at the same tolerance, for 1e-3 to 1e-10, or by the tolerance where
there is no CVODES.

Sources: Hairer and Wanner, Solving Ordinary Differential Equations II, sec. IV.1 and IV.10; Hindmarsh et al., SUNDIALS, ACM Trans. Math.
Softw. 31 (2005).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import chdir
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import casadi
import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

import flexfmu

EXAMPLES = Path(__file__).parents[1] / "examples"
POINTS, ENOUGH, REPEATED = 20, 0.05, 3
TOLERANCES = 10.0 ** np.arange(-3.0, -12.1, -0.5)
DECADES = [float(each) for each in TOLERANCES[:15:2]]


@dataclass(frozen=True)
class Problem:
    """A model, its end [s], whether the reference needs an implicit method, and the states in closed form where there are events,
    which CasADi's CVODES only tries to find."""

    model: Any
    end: float
    stiff: bool = False
    exact: Callable[[float], list[float]] | None = None


def van_der_pol(mu: float) -> Any:
    """The oscillator of van der Pol."""
    rhs = lambda x, p: [x.x0_rate, p.mu * (1 - x.x0**2) * x.x0_rate - x.x0]  # noqa: E731
    size = flexfmu.variable(0.0, nominal=mu)
    return flexfmu.ode(f"vdp{mu:.0f}", x={"x0": 2.0, "x0_rate": size}, p={"mu": mu}, rhs=rhs)


def brusselator(cells: int = 20) -> Any:
    """The reactions of the Brusselator with diffusion along a line."""

    def rates(x: Any, p: Any) -> list[Any]:
        values = list(x)
        u, v = [1.0, *values[:cells], 1.0], [3.0, *values[cells:], 3.0]
        inner = range(1, cells + 1)
        du = [1 + u[k] ** 2 * v[k] - 4 * u[k] + p.d * (u[k - 1] - 2 * u[k] + u[k + 1]) for k in inner]
        return [*du, *(3 * u[k] - u[k] ** 2 * v[k] + p.d * (v[k - 1] - 2 * v[k] + v[k + 1]) for k in inner)]

    start = {f"u[{k}]": 1 + np.sin(2 * np.pi * k / (cells + 1)) for k in range(1, cells + 1)}
    start |= {f"v[{k}]": 3.0 for k in range(1, cells + 1)}
    return flexfmu.ode("brusselator", x=start, p={"d": (cells + 1) ** 2 / 50.0}, rhs=rates)


def lotka() -> Any:
    """Prey and predators."""
    return flexfmu.ode("lotka", x={"a": 1.0, "b": 1.0}, rhs=lambda x: [x.a * (1.5 - x.b), x.b * (x.a - 3.0)])


def pendulum() -> Any:
    """A pendulum with its rod force as the variable of a constraint."""
    return flexfmu.dae(
        "pendulum",
        x={"x": 1.0, "y": 0.0, "vx": 0.0, "vy": 0.0},
        z={"force": 0.0},
        rhs=lambda x, z: [x.vx, x.vy, -z.force * x.x, -z.force * x.y - 9.81],
        constraints=lambda x, z: x.vx**2 + x.vy**2 - z.force * (x.x**2 + x.y**2) - 9.81 * x.y,
    )


def ball() -> Any:
    """A ball that bounces."""
    bounce = flexfmu.event(lambda q: q.height, -1, lambda v: {"der(height)": -0.8 * v.height})
    return flexfmu.second_order(
        "ball", q={"height": 1.0}, residual=lambda a: a.height + 9.81, events={"bounce": bounce}
    )


def ball_states(t: float) -> list[float]:
    """Height and speed, from bounce to bounce."""
    begin, speed, height = 0.0, 0.0, 1.0
    while (fall := (speed + np.sqrt(speed**2 + 2 * 9.81 * height)) / 9.81) < t - begin:
        begin, speed, height = begin + fall, 0.8 * (9.81 * fall - speed), 0.0
    return [height + speed * (t - begin) - 9.81 * (t - begin) ** 2 / 2, speed - 9.81 * (t - begin)]


def belt() -> Any:
    """A mass on a spring and a belt with dry friction: it sticks, slips, and sticks again."""
    return flexfmu.second_order(
        "belt",
        q={"slip": flexfmu.variable(0.0, nominal=0.1)},
        residual=lambda q, a, t: a.slip + 100.0 * (q.slip + 0.1 * t),
        friction={"slip": (10.0, 6.0)},
    )


def belt_states(t: float) -> list[float]:
    """Slip and its rate: the mass leaves the belt at 0.1 m, swings about 0.06 m, and is caught at 0.02 m."""
    begin, place = 0.0, 0.0
    swing = (np.pi + 2 * np.arctan2(0.01, 0.04)) / 10
    while True:
        stuck = (0.1 - place) / 0.1
        if t - begin <= stuck:
            return [place - 0.1 * begin, 0.0]
        slipping = t - begin - stuck
        if slipping <= swing:
            c, s = np.cos(10 * slipping), np.sin(10 * slipping)
            return [0.06 + 0.04 * c + 0.01 * s - 0.1 * t, 0.1 * c - 0.4 * s - 0.1]
        begin, place = begin + stuck + swing, 0.02


def problems() -> dict[str, Problem]:
    """The problems; some are those of the examples."""
    sys.path.insert(0, str(EXAMPLES))
    from own_cart_pole import cart_pole
    from own_heat_rod import rod
    from own_robertson import robertson
    from own_slider_crank import slider_crank

    return {
        "vdp1": Problem(van_der_pol(1.0), 20.0),
        "vdp1000": Problem(van_der_pol(1000.0), 2000.0, stiff=True),
        "robertson": Problem(robertson, 1e4, stiff=True),
        "brusselator": Problem(brusselator(), 10.0, stiff=True),
        "lotka": Problem(lotka(), 20.0),
        "cart_pole": Problem(cart_pole, 3.0),
        "pendulum": Problem(pendulum(), 3.0),
        "slider_crank": Problem(slider_crank, 0.3),
        "heat_rod": Problem(rod, 600.0, stiff=True),
        "ball": Problem(ball(), 2.5, exact=ball_states),
        "belt": Problem(belt(), 4.0, exact=belt_states),
    }


def first_order(model: Any) -> tuple[casadi.SX, casadi.SX, Any, list[str]]:
    """Symbols of the states, their rates, start values, and the outputs that show them, from the functions of a model without time."""
    n, functions = model.degrees_of_freedom, model.functions
    p = [each.start for each in model.parameters]
    d, u = functions["derive"](p), [each.start for each in model.inputs]
    x = casadi.SX.sym("x", len(model.states))
    motion = casadi.SX.zeros(2 * n)
    motion[list(model.states)] = x
    clock = casadi.SX.sym("t")
    if model.has_clock:
        motion[n - 1], motion[2 * n - 1] = clock, 1
    y, v = motion[:n], motion[n:]
    bias = functions["residual"](y, v, casadi.SX.zeros(n), u, d)
    mass = casadi.sparsify(functions["mass_matrix"](y, u, d))
    a = casadi.solve(mass, -bias) if model.first_order < n else -bias
    rates = casadi.vertcat(v, a)[list(model.states)]
    start = functions["initial_coordinates"](p).full().ravel()[list(model.states)]
    second = model.unknowns[: n - model.has_clock - model.first_order]
    names = [*second, *(f"der({each})" for each in second), *model.unknowns[len(second) : n - model.has_clock]]
    return x, casadi.cse(rates), start, names


def timed(run: Callable[[], Any]) -> tuple[Any, float]:
    """The result, and the least processor time [s]."""
    least, total = np.inf, 0.0
    for count in range(1000):
        begin = process_time()
        result = run()
        took = process_time() - begin
        least, total = min(least, took), total + took
        if total > ENOUGH and count + 1 >= REPEATED:
            break
    return result, least


def ours(problem: Problem, names: list[str], folder: Path, tolerances: Any) -> Iterator[tuple[float, Any, float]]:
    """Tolerance, states (points, states) and time of the FMU."""
    times = np.linspace(0.0, problem.end, POINTS + 1)
    path = flexfmu.build(problem.model, folder / "model.fmu", step=problem.end / POINTS, stop_time=problem.end)
    description = fmpy.read_model_description(str(path))
    references = {each.name: each.valueReference for each in description.modelVariables}
    unpacked = fmpy.extract(str(path), str(folder / "unpacked"))
    fmu = FMU2Slave(
        guid=description.guid,
        unzipDirectory=unpacked,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="benchmark",
    )
    fmu.instantiate()
    wanted = [references[name] for name in names]
    for tolerance in tolerances:
        spent = []

        def integrate(tolerance: float = tolerance, spent: list[float] = spent) -> Any:
            fmu.reset()
            fmu.setupExperiment(tolerance=tolerance, startTime=0.0)
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
            rows, begin = [fmu.getReal(wanted)], process_time()
            for k in range(POINTS):
                fmu.doStep(times[k], times[k + 1] - times[k])
                rows.append(fmu.getReal(wanted))
            spent.append(process_time() - begin)
            return np.array(rows)

        states, _ = timed(integrate)
        yield tolerance, states, min(spent)
    fmu.terminate()
    fmu.freeInstance()


def cvodes(
    problem: Problem, x: casadi.SX, rates: casadi.SX, start: Any, tolerances: Any
) -> Iterator[tuple[float, Any, float]]:
    """The same of CasADi's CVODES, whose functions are compiled."""
    times = np.linspace(0.0, problem.end, POINTS + 1)
    # in units of their nominals: the absolute tolerance is one number
    sizes = casadi.DM(problem.model.nominals)
    scaled = casadi.substitute(rates, x, x * sizes) / sizes
    for tolerance in tolerances:
        limits = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 1000000}
        options = {**limits, "jit": True, "compiler": "shell", "jit_options": {"flags": "-O2"}}
        try:
            integrator = casadi.integrator(
                "integrator", "cvodes", {"x": x, "ode": scaled}, 0.0, times[1:].tolist(), options
            )
            states, time = timed(lambda integrator=integrator: integrator(x0=start / sizes)["xf"].full().T)
        except RuntimeError:
            continue
        yield tolerance, np.vstack([start, states * sizes.full().T]), time


def reference(problem: Problem, x: casadi.SX, rates: casadi.SX, start: Any) -> Any:
    """The states at the points by SciPy, (points, states)."""
    function = casadi.Function("rates", [x], [rates])
    jacobian = casadi.Function("jacobian", [x], [casadi.densify(casadi.jacobian(rates, x))])
    return solve_ivp(
        lambda t, s: function(s).full().ravel(),
        (0.0, problem.end),
        start,
        method="Radau" if problem.stiff else "DOP853",
        t_eval=np.linspace(0.0, problem.end, POINTS + 1),
        rtol=3e-13,
        atol=3e-14 * np.array(problem.model.nominals),
        **({"jac": lambda t, s: jacobian(s).full()} if problem.stiff else {}),
    ).y.T


def error_ratios(name: str, mine: dict[float, float], theirs: dict[float, float]) -> list[float]:
    """Print our errors relative to those of CVODES at the same tolerance, or to the tolerance without CVODES; return them."""
    ratios = [mine[each] / theirs.get(each, each) for each in DECADES if not theirs or each in theirs]
    print(
        f"{name:14} {' '.join(f'{each:8.2g}' for each in ratios)}{'' if theirs else '   of the tolerance'}", flush=True
    )
    return ratios if theirs else []


def time_for(error: float, curve: list[tuple[float, float]]) -> float | None:
    """Time for an error, interpolated between the cheapest runs; None where no run is as exact."""
    reached = [time for found, time in curve if found <= error]
    if not reached:
        return None
    front = sorted(curve, reverse=True)
    for (coarse, before), (fine, after) in pairwise(front):
        if fine <= error < coarse:
            share = np.log(coarse / error) / np.log(coarse / fine)
            return float(min(np.exp((1 - share) * np.log(before) + share * np.log(after)), min(reached)))
    return min(reached)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--error", type=float, default=1e-6)
    parser.add_argument("--only", default="")
    parser.add_argument("--same-tolerance", action="store_true")
    options = parser.parse_args()
    tolerances = DECADES if options.same_tolerance else TOLERANCES
    chosen = [each for each in options.only.split(",") if each]
    if options.same_tolerance:
        print(f"{'tolerance':14} {' '.join(f'{each:8.0e}' for each in DECADES)}")
    else:
        print(
            f"{'problem':14} {'states':>6}  {'FMU [ms]':>9}  {'CVODES [ms]':>11}  {'ratio':>6}   for an error of {options.error:g}"
        )
    ratios = []
    for name, problem in problems().items():
        if chosen and name not in chosen:
            continue
        x, rates, start, names = first_order(problem.model)
        if problem.exact:
            exact = np.array([problem.exact(t) for t in np.linspace(0.0, problem.end, POINTS + 1)])
        else:
            exact = reference(problem, x, rates, start)
        size = abs(exact).max(axis=0)

        def curve(
            trials: Iterator[tuple[float, Any, float]], exact: Any = exact, size: Any = size
        ) -> dict[float, tuple[float, float]]:
            return {float(each): ((abs(states - exact) / size).max(), time) for each, states, time in trials}

        # CasADi compiles in the working directory
        with TemporaryDirectory() as folder, chdir(folder):
            our_curve = curve(ours(problem, names, Path(folder), tolerances))
            their_curve = curve(cvodes(problem, x, rates, start, tolerances)) if problem.exact is None else {}
        if options.same_tolerance:
            errors = ({each: error for each, (error, _) in found.items()} for found in (our_curve, their_curve))
            ratios += error_ratios(name, *errors)
            continue
        mine, theirs = (time_for(options.error, [*found.values()]) for found in (our_curve, their_curve))
        texts = [f"{1e3 * each:.3f}" if each else "-" for each in (mine, theirs)]
        if mine and theirs:
            ratios.append(theirs / mine)
        ratio = f"{theirs / mine:.2f}" if mine and theirs else "-"
        print(f"{name:14} {len(start):6}  {texts[0]:>9}  {texts[1]:>11}  {ratio:>6}", flush=True)
    if options.same_tolerance:
        print(f"our error is at most that of CVODES in {sum(each <= 1 for each in ratios)} of {len(ratios)}")
    elif ratios:
        print(f"ratio: how many times longer CVODES takes; geometric mean {np.exp(np.mean(np.log(ratios))):.2f}")


if __name__ == "__main__":
    main()
