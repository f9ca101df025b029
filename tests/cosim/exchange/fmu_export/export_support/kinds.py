"""Every kind of block that the toolkit makes, and what each does with ramps, sines and steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import blocks
import casadi
import control
import numpy as np
from numpy.typing import NDArray

import flexfmu
from export_support.blocks import SAMPLE_TIME, expected
from flexfmu.cosim.control.controllers.from_control import control_block, state_space
from flexfmu.cosim.control.controllers.own_function import controller, function_block
from flexfmu.cosim.control.controllers.state_feedback import state_feedback, static_feedforward
from flexfmu.cosim.control.disturbances import steps, sum_block
from flexfmu.cosim.control.filters import filter_block, low_pass, notch
from flexfmu.cosim.control.shapers import shaper_block
from flexfmu.cosim.experiment.planning import plan
from flexfmu.fmu_build.regular_sampling import regular
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock, Variable
from flexfmu.trajectories.shapers.sequence import ImpulseSequence

Array = NDArray[np.float64]

SEQUENCE = ImpulseSequence((0.0, 0.0081, 0.0163), (0.3, 0.45, 0.25))
START: Any = {"signal": "position", "initial": (0.4, -0.6)}


def feedback() -> SymbolicBlock:
    """Feedback of an observer's states, which follows a reference."""
    plant = oscillator()
    return state_feedback(plant, [[2.0, 1.0]], [[0.4], [0.3]], reference=static_feedforward(plant, ["y[0]"]))


def oscillator() -> Any:
    """A damped double integrator."""
    return blocks.linear_system([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.2]], [[1.0, 0.0]], [[0.0]], SAMPLE_TIME)


def in_c() -> SymbolicBlock:
    """A function in C with states, parameters and the time."""
    names: Any = {"inputs": ["u1", "u2"], "outputs": ["y1", "y2"], "parameters": {"a": 0.9, "b": 3.0}}
    block: SymbolicBlock = blocks.c_function(Path(__file__).with_name("filter.c"), states=[0.2, -0.1], **names, **TIME)
    return block


def of_python() -> SymbolicBlock:
    """The same function in Python."""

    @controller(inputs=["u1", "u2"], outputs=["y1", "y2"], state=[0.2, -0.1], symbolic=True, **TIME)
    def filtered(t: Any, measurement: Any, state: Any, *, a: float = 0.9, b: float = 3.0) -> Any:
        return a * state + b * measurement * np.sin(40.0 * t), a * state + (1.0 - a) * measurement

    return function_block(filtered)


DRIVEN: Any = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1}
TIME: Any = {"sample_time": SAMPLE_TIME}

SCHEDULE = {"over": "load", "at": (-1.0, 0.0, 0.8), "proportional": [0.2, (1.0, 1.5), 2.0], "integral": [0.0, 1.0, 1.2]}
LOOPS = (
    {"proportional": (40.0, 30.0), "velocity_feedforward": 0.9, "velocity_limit": 25.0},
    {"proportional": (9.0, 8.0), "integral": 500.0},
)
PERIOD: Any = {"gain": 100.0, "cycles": 2, "period": 40 * SAMPLE_TIME}


def drive() -> tuple[SymbolicBlock, ...]:
    """The loops of a cascade."""
    position, velocity = LOOPS
    keys = {"torque_limit": 8.0, "initial": (0.3, -0.2), **TIME}
    loops: tuple[SymbolicBlock, ...] = blocks.cascade(
        position, velocity | {"inertia": 0.2}, {"time_constant": 2e-3}, **keys
    )
    return loops


def learning_along_the_path() -> SymbolicBlock:
    """The norm-optimal law at two places."""
    decay = np.array([1.0, 1.5])[:, None, None, None] * 0.5 ** np.arange(8.0)[:, None, None]
    response = (decay * np.array([[1.0, 0.2], [0.1, 0.8]])).tolist()
    path = plan(load_scene("barnard2012-6kg"))
    context = {"path": path.along_path, "shaped": path.joints, "period": 40 * SAMPLE_TIME}
    block: SymbolicBlock = blocks.learning(
        law="norm-optimal", response=response, q_filter="none", cycles=2, **context, **TIME
    )
    return block


def written(text: str) -> str:
    """A file with a text, which stays."""
    path = Path(mkdtemp()) / "force.csv"
    path.write_text(text)
    return str(path)


KINDS: dict[str, Callable[[], Any]] = {
    "pd": lambda: blocks.pd((900.0, 800.0), 12.0, torque_limit=40.0, **TIME),
    "pid": lambda: blocks.pid(900.0, 4e4, 12.0, filter_time=3e-3, torque_limit=40.0, **TIME),
    "pid: unfiltered": lambda: blocks.pid(0.0, 0.0, 100.0, **TIME),
    "pid: scheduled": lambda: blocks.pid(900.0, 4e4, 12.0, schedule=SCHEDULE, **TIME),
    "cascade: position": lambda: drive()[0],
    "cascade: velocity": lambda: drive()[1],
    "cascade: current": lambda: drive()[2],
    "cascade: unlimited velocity": lambda: blocks.cascade(*LOOPS, **TIME)[1],
    "friction-compensation": lambda: blocks.friction_compensation((1.5, 2.0), 3.0, 0.1, **TIME),
    "gravity-feedforward": lambda: blocks.gravity_feedforward(**TIME),
    "disturbance-observer": lambda: blocks.disturbance_observer(5e-3, (0.2, 0.3), torque_limit=60.0, **TIME),
    "computed-torque": lambda: blocks.computed_torque(4e3, 90.0, **TIME),
    "feedforward": lambda: blocks.feedforward(**TIME),
    "feedforward: flexible": lambda: blocks.feedforward(
        "flexible", path=plan(load_scene("barnard2012-6kg")).joints, **TIME
    ),
    "sum": lambda: sum_block("sum", "Sum", {f"joint{i}.feedforward": ("a", "b") for i in (1, 2)}, **TIME),
    "step": lambda: regular(blocks.step(1.5, signal="force.x", start=SAMPLE_TIME)),
    "pulse": lambda: regular(blocks.pulse(1.5, signal="force.x", start=SAMPLE_TIME, duration=8 * SAMPLE_TIME)),
    "payload": lambda: regular(
        steps("payload.change", {SAMPLE_TIME: 1.5, 9 * SAMPLE_TIME: 0.5, 10 * SAMPLE_TIME: 0.0}, "step")
    ),
    "sine": lambda: blocks.sine(3.0, frequency=40.0, signal="force.x", phase=0.3, duration=0.04, **TIME),
    "noise: disturbance": lambda: blocks.band_noise(2.0, (5.0, 60.0), 8, 3, signal="joint1.disturbance", **TIME),
    "csv": lambda: blocks.table(written("time,force.y\n0.0,1.0\n0.01,-2.0\n0.05,3.0\n"), signal="force.y", **TIME),
    "learning": lambda: blocks.learning(lead=2, forgetting=0.01, **PERIOD, **TIME),
    "learning: filtered": lambda: blocks.learning(lead=2, q_filter=0.25 / SAMPLE_TIME, **PERIOD, **TIME),
    "learning: norm-optimal": learning_along_the_path,
    "state-feedback: own": feedback,
    "state-feedback": lambda: blocks.lqg(scene=load_scene("barnard2012-6kg").replace(DRIVEN), **TIME),
    "h-infinity": lambda: blocks.h_infinity(3.0, scene=load_scene("barnard2012-6kg").replace(DRIVEN), **TIME),
    "state-space": lambda: state_space(oscillator()),
    "c-function": in_c,
    "function": of_python,
    "control": lambda: control_block(control.tf([0.02, 1.0], [0.01, 1.0]).sample(SAMPLE_TIME, "tustin")),
    "shaper": lambda: shaper_block(SEQUENCE, SAMPLE_TIME),
    "notch": lambda: filter_block(
        flexfmu.filters.notch(frequency=1.0, **TIME), blocks.context("filter"), [*notch(40.0), *low_pass(90.0, 3)]
    ),
    "low-pass": lambda: blocks.low_pass(frequency=90.0, **TIME),
    "high-pass": lambda: blocks.high_pass(frequency=20.0, order=3, **TIME),
    "lead-lag": lambda: blocks.lead_lag(20.0, 90.0, **TIME),
    "biquad": lambda: blocks.biquad([2.0, 30.0], [1.0, 50.0, 900.0], **TIME),
    "saturation": lambda: blocks.saturation(lower=-0.5, upper=0.7, **TIME),
    "dead-zone": lambda: blocks.dead_zone(0.2, **TIME),
    "backlash": lambda: blocks.backlash(0.3, **TIME),
    "rate-limit": lambda: blocks.rate_limit(100.0, 80.0, **START, **TIME),
    "delay: whole": lambda: blocks.delay(5 * SAMPLE_TIME, **START, **TIME),
    "delay: long": lambda: blocks.delay(150 * SAMPLE_TIME, **START, **TIME),
    "delay": lambda: blocks.delay(2.3 * SAMPLE_TIME, **START, **TIME),
    "delay: short": lambda: blocks.delay(0.4 * SAMPLE_TIME, **START, **TIME),
    "delay: Lagrange": lambda: blocks.delay(2.3 * SAMPLE_TIME, {"kind": "lagrange", "order": 3}, **START, **TIME),
    "delay: Thiran": lambda: blocks.delay(2.3 * SAMPLE_TIME, {"kind": "thiran", "order": 2}, **START, **TIME),
    "quantisation": lambda: blocks.quantisation(1e-2, **TIME),
    "encoder": lambda: blocks.encoder(4000, window=3, **TIME),
    "lag": lambda: blocks.lag(2e-3, **START, **TIME),
    "jitter": lambda: blocks.jitter(0.8 * SAMPLE_TIME, 5, initial=(0.4, -0.6), **TIME),
    "noise": lambda: blocks.noise([0.1, 0.2], seed=5, **TIME),
    "noise: uniform": lambda: blocks.noise(half_width=0.1, seed=5, **TIME),
}
"""Kind of a section, variants behind a colon → a block of it."""


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
