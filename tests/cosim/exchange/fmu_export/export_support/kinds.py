"""Every kind of block that the toolkit makes, and what each does with ramps, sines and steps."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi
import control
import numpy as np
from numpy.typing import NDArray

from export_support.blocks import SAMPLE_TIME, expected
from flexfmu.cosim.control.controllers.c_function import c_function
from flexfmu.cosim.control.controllers.cascade import current_loop, position_loop, velocity_loop
from flexfmu.cosim.control.controllers.compensation import disturbance_observer, friction_compensation
from flexfmu.cosim.control.controllers.computed_torque import (
    computed_torque,
    gravity_feedforward,
    inverse_dynamics_feedforward,
    tabulated_feedforward,
)
from flexfmu.cosim.control.controllers.from_control import control_block
from flexfmu.cosim.control.controllers.function_controller import function_block
from flexfmu.cosim.control.controllers.gain_schedule import scheduled
from flexfmu.cosim.control.controllers.h_infinity import h_infinity
from flexfmu.cosim.control.controllers.iterative_learning import iterative_learning, norm_optimal_learning
from flexfmu.cosim.control.controllers.joints import symmetric
from flexfmu.cosim.control.controllers.linear_system import linear_system, state_space
from flexfmu.cosim.control.controllers.own_function import controller
from flexfmu.cosim.control.controllers.pid import pd, pid
from flexfmu.cosim.control.controllers.state_feedback import lqg, state_feedback, static_feedforward
from flexfmu.cosim.control.disturbances import band_noise, sine, steps, table
from flexfmu.cosim.control.filters import filter_block, low_pass, notch
from flexfmu.cosim.control.imperfections.channels import joint_channels
from flexfmu.cosim.control.imperfections.delay import Lagrange, Thiran, delay, whole_delay
from flexfmu.cosim.control.imperfections.lag import lag
from flexfmu.cosim.control.imperfections.signal_blocks import (
    backlash,
    dead_zone,
    encoder,
    gaussian_noise,
    jitter,
    quantisation,
    rate_limit,
    saturation,
    uniform_noise,
)
from flexfmu.cosim.control.shapers import shaper_block
from flexfmu.cosim.control.sums import disturbance_sum, feedforward_sum
from flexfmu.fmu_build.regular_sampling import regular
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock, Variable
from flexfmu.trajectories.shapers.sequence import ImpulseSequence

Array = NDArray[np.float64]

SEQUENCE = ImpulseSequence((0.0, 0.0081, 0.0163), (0.3, 0.45, 0.25))
POSITIONS = joint_channels("position", (0.4, -0.6))


def robot() -> Any:
    """Rigid inverse dynamics of the paper's robot."""
    return inverse_dynamics(load_scene("barnard2012-6kg"))


def feedback() -> SymbolicBlock:
    """Feedback of an observer's states, which follows a reference."""
    plant = oscillator()
    return state_feedback(plant, [[2.0, 1.0]], [[0.4], [0.3]], reference=static_feedforward(plant, ["y[0]"]))


def oscillator() -> Any:
    """A damped double integrator."""
    return linear_system([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.2]], [[1.0, 0.0]], sample_time=SAMPLE_TIME)


def in_c() -> SymbolicBlock:
    """A function in C with states, parameters and the time."""
    names: Any = {"inputs": ["u1", "u2"], "outputs": ["y1", "y2"], "parameters": {"a": 0.9, "b": 3.0}}
    return c_function(Path(__file__).with_name("filter.c"), states=[0.2, -0.1], **names, **TIME)


def of_python() -> SymbolicBlock:
    """The same function in Python."""

    @controller(inputs=["u1", "u2"], outputs=["y1", "y2"], state=[0.2, -0.1], symbolic=True, **TIME)
    def filtered(t: Any, measurement: Any, state: Any, *, a: float = 0.9, b: float = 3.0) -> Any:
        return a * state + b * measurement * np.sin(40.0 * t), a * state + (1.0 - a) * measurement

    return function_block(filtered)


DRIVEN: Any = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1}
TIME: Any = {"sample_time": SAMPLE_TIME}

TABLES = {"proportional_gain": [0.2, (1.0, 1.5), 2.0], "integral_gain": [0.0, 1.0, 1.2]}

KINDS: dict[str, Callable[[], SymbolicBlock]] = {
    "pd": lambda: pd((900.0, 800.0), 12.0, limits=symmetric(40.0), **TIME),
    "pid": lambda: pid(900.0, 4e4, 12.0, filter_time=3e-3, limits=symmetric(40.0), **TIME),
    "pid: unfiltered": lambda: pid(0.0, 0.0, 100.0, **TIME),
    "position_loop": lambda: position_loop((40.0, 30.0), velocity_feedforward=0.9, velocity_limit=25.0, **TIME),
    "velocity_loop": lambda: velocity_loop(9.0, 500.0, inertia=0.2, limits=symmetric(8.0), **TIME),
    "velocity_loop: unlimited": lambda: velocity_loop((9.0, 8.0), 500.0, commands_current=False, **TIME),
    "current_loop": lambda: current_loop(2e-3, limits=symmetric(0.8), initial_torque=(0.3, -0.2), **TIME),
    "friction_compensation": lambda: friction_compensation((1.5, 2.0), 3.0, velocity=0.1, **TIME),
    "gravity_feedforward": lambda: gravity_feedforward(robot(), **TIME),
    "disturbance_observer": lambda: disturbance_observer((0.2, 0.3), 5e-3, limits=symmetric(60.0), **TIME),
    "feedforward_sum": lambda: feedforward_sum({f"joint{i}.feedforward": ("a", "b") for i in (1, 2)}, **TIME),
    "scheduled": lambda: scheduled(pid(900.0, 4e4, 12.0, **TIME), "load", (-1.0, 0.0, 0.8), TABLES),
    "computed_torque": lambda: computed_torque(robot(), 4e3, 90.0, **TIME),
    "inverse_dynamics_feedforward": lambda: inverse_dynamics_feedforward(robot(), **TIME),
    "steps": lambda: regular(
        steps("payload.change", (SAMPLE_TIME, 9 * SAMPLE_TIME, 10 * SAMPLE_TIME), (1.5, 0.5, 0.0))
    ),
    "sine": lambda: sine("force.x", 3.0, 40.0, phase=0.3, duration=0.04, **TIME),
    "band_noise": lambda: band_noise("joint1.disturbance", 2.0, (5.0, 60.0), 3, components=8, **TIME),
    "table": lambda: table("force.y", np.array([0.0, 0.01, 0.05]), np.array([1.0, -2.0, 3.0]), **TIME),
    "disturbance_sum": lambda: disturbance_sum("force.x", ("a", "b"), **TIME),
    "tabulated_feedforward": lambda: tabulated_feedforward(np.linspace(-1.0, 2.0, 160).reshape(80, 2), **TIME),
    "iterative_learning": lambda: iterative_learning(100.0, 40, shift=2, forgetting=0.01, **TIME),
    "iterative_learning:filtered": lambda: iterative_learning(100.0, 40, shift=2, q_filter=0.25 / SAMPLE_TIME, **TIME),
    "norm_optimal_learning": lambda: norm_optimal_learning(
        np.array([1.0, 1.5])[:, None, None, None]
        * 0.5 ** np.arange(8.0)[:, None, None]
        * np.array([[1.0, 0.2], [0.1, 0.8]]),
        np.linspace(0.0, 1.0, 40),
        **TIME,
    ),
    "state_feedback": feedback,
    "lqg": lambda: lqg(load_scene("barnard2012-6kg").replace(DRIVEN), (0.0, 0.32), **TIME),
    "h_infinity": lambda: h_infinity(load_scene("barnard2012-6kg").replace(DRIVEN), (0.0, 0.32), 3.0, **TIME),
    "state_space": lambda: state_space(oscillator()),
    "c_function": in_c,
    "function_block": of_python,
    "control_block": lambda: control_block(control.tf([0.02, 1.0], [0.01, 1.0]), method="tustin", **TIME),
    "shaper_block": lambda: shaper_block(SEQUENCE, SAMPLE_TIME),
    "filter_block": lambda: filter_block(POSITIONS, [*notch(40.0), *low_pass(90.0, 3)], **TIME),
    "saturation": lambda: saturation(POSITIONS, -0.5, 0.7, **TIME),
    "dead_zone": lambda: dead_zone(POSITIONS, 0.2, **TIME),
    "backlash": lambda: backlash(POSITIONS, 0.3, **TIME),
    "rate_limit": lambda: rate_limit(POSITIONS, 100.0, 80.0, **TIME),
    "whole_delay": lambda: whole_delay(POSITIONS, 5, **TIME),
    "whole_delay: long": lambda: whole_delay(POSITIONS, 150, **TIME),
    "delay": lambda: delay(POSITIONS, 2.3 * SAMPLE_TIME, **TIME),
    "delay: short": lambda: delay(POSITIONS, 0.4 * SAMPLE_TIME, **TIME),
    "delay: Lagrange": lambda: delay(POSITIONS, 2.3 * SAMPLE_TIME, interpolation=Lagrange(3), **TIME),
    "delay: Thiran": lambda: delay(POSITIONS, 2.3 * SAMPLE_TIME, interpolation=Thiran(2), **TIME),
    "quantisation": lambda: quantisation(POSITIONS, 1e-2, **TIME),
    "encoder": lambda: encoder(4000, window=3, **TIME),
    "lag": lambda: lag(POSITIONS, 2e-3, **TIME),
    "jitter": lambda: jitter(POSITIONS, 0.8 * SAMPLE_TIME, 5, **TIME),
    "gaussian_noise": lambda: gaussian_noise(POSITIONS, [0.1, 0.2], 5, **TIME),
    "uniform_noise": lambda: uniform_noise(POSITIONS, 0.1, 5, **TIME),
}
"""Name of the function that makes a kind, variants behind a colon → a block of it."""


def makers(*rooms: Any) -> set[str]:
    """Names of all functions of these packages that make a block."""
    names = set()
    for room in rooms:
        for each in pkgutil.iter_modules(room.__path__):
            module = importlib.import_module(f"{room.__name__}.{each.name}")
            for name, function in inspect.getmembers(module, inspect.isfunction):
                makes = function.__annotations__.get("return") in ("SymbolicBlock", SymbolicBlock)
                if makes and function.__module__ == module.__name__ and not name.startswith("_"):
                    names.add(name)
    return names


STAGE = 50
"""Samples after which what was a ramp becomes a sine, and that a step."""

POSES = (3.2407, 1.1738) * 2
"""Joint angles near which the robot can be assembled: references and measurements."""

SIGNALS = 12
"""Outputs of the source before those for `POSES`; each feeds one input of a block at most."""


def source() -> SymbolicBlock:
    """Ramps of 2/s, sines and steps of different heights, without inputs; then small ones about each of `POSES`."""
    k, no = casadi.SX.sym("k"), casadi.SX.sym("no", 0)
    ramp, sine = 2.0 * SAMPLE_TIME * (k - STAGE * casadi.floor(k / STAGE)), casadi.sin(0.3 * k)
    shapes = [ramp, sine, casadi.if_else(casadi.fmod(k, 20.0) < 10.0, 0.0, 1.0)]
    stage = casadi.fmod(casadi.floor(k / STAGE), 3.0)
    turns = [
        casadi.if_else(stage < 1, shapes[i], casadi.if_else(stage < 2, shapes[i - 1], shapes[i - 2])) for i in range(3)
    ]
    signals = [(1.0 + 0.1 * i) * turns[i % 3] for i in range(SIGNALS)]
    signals += [pose + 0.02 * turns[i % 3] for i, pose in enumerate(POSES)]
    return SymbolicBlock(
        name="source",
        description="Ramps, sines and steps",
        sample_time=SAMPLE_TIME,
        inputs=(),
        outputs=tuple(Variable(f"signal{i}", "1", f"Signal {i}", "output") for i in range(len(signals))),
        states=(0.0,),
        output=casadi.Function("output", [k, no, no], [casadi.vertcat(*signals)]),
        update=casadi.Function("update", [k, no, no], [k + 1.0]),
    )


def signals_of(block: SymbolicBlock) -> list[int]:
    """The output of the source that each input of a block is connected to; angles of the robot where it must be assembled."""
    names = [each.name for each in block.inputs]
    has_motion = any(name.endswith("acceleration") for name in names) or block.name == "gravity_feedforward"
    angles = [name for name in names if has_motion and name.endswith("position")]
    return [SIGNALS + angles.index(name) if name in angles else i for i, name in enumerate(names)]


def motion(block: SymbolicBlock, count: int) -> Array:
    """Inputs (count, inputs) from the source."""
    signals = expected(source(), np.empty((count, 0)))
    return signals[:, signals_of(block)]


def seen_late(block: SymbolicBlock, inputs: Array) -> Array:
    """What an importer reads at the instants that sets its inputs afterwards, (count, outputs): outputs with direct
    feedthrough are those of the sample before."""
    on_time = expected(block, inputs)
    late = np.vstack([on_time[:1], on_time[:-1]])
    feeds = [bool(block.feedthrough.get(each.name, block.inputs)) for each in block.outputs]
    return np.where(feeds, late, on_time)
