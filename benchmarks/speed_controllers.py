"""What a sample of each kind of controller, filter, imperfection and disturbance costs beside a plant that does nothing. Used by `speed.py`; not a script of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from idle import idle_fmu
from paper_scene import SCENE, Timed, best_times, timed
from speed_figure import SpeedFigure

from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import Simulator
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.wiring import wire

DRIVEN = SCENE.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})

TIME = {"sample_time": 2.5e-4}
"""Of all loops, and the communication step [s]: 4 kHz."""

SECONDS = 4.0
"""Length of the runs that tell what a sample costs."""

ROUNDS = 4
"""Rounds of runs of which the fastest counts."""

PD = {"kind": "pd", "proportional": 1e3, "derivative": 10.0, **TIME}
CASCADE = {
    "kind": "cascade",
    "position": {"proportional": 60.0},
    "velocity": {"proportional": 120.0, "integral": 6e3},
    "current": {"time_constant": 2e-4},
    "torque_limit": 90.0,
    **TIME,
}

H_INFINITY = {"kind": "h-infinity", "bandwidth": 20.0, "torque_limit": 90.0, **TIME}
GRAVITY = {"kind": "gravity-feedforward", **TIME}
FRICTION = {"kind": "friction-compensation", "viscous": 1.0, "coulomb": 2.0, **TIME}
OBSERVER = {"kind": "disturbance-observer", "time_constant": 0.02, **TIME}
FEEDFORWARD = {"kind": "feedforward", **TIME}
LINEAR = {
    "kind": "state-space",
    "A": [[0.9, 0.0], [0.0, 0.8]],
    "B": [[0.1, 0.0], [0.0, 0.2]],
    "C": [[-2.0, 0.0], [0.0, -2.0]],
    "inputs": ["joint1.velocity", "joint2.velocity"],
    "outputs": ["joint1.feedforward", "joint2.feedforward"],
    **TIME,
}
SCHEDULE = {
    "over": "joint1.position",
    "at": [2.5, 3.0, 3.5],
    "proportional": [0.8, 1.0, 1.2],
    "derivative": [1.0, 1.0, 1.1],
}

FORCE = {"signal": "force.x"}
SINE = {"kind": "sine", "amplitude": 5.0, "frequency": 20.0, **FORCE, **TIME}
BAND = {"kind": "noise", "standard_deviation": 5.0, "band": [5.0, 50.0], **FORCE, **TIME}
STEP = {"kind": "step", "amplitude": 5.0, **FORCE}
CSV = {
    "kind": "csv",
    "file": str(Path(__file__).parents[1] / "examples" / "disturbance.csv"),
    "column": "force",
    **FORCE,
    **TIME,
}
DROP = {"kind": "payload", "dropped": 0.2}

DISTURBED: Mapping[str, tuple[Sequence[dict[str, Any]], float]] = {
    "sine disturbance": ([SINE], 0.5),
    "band noise of 50 sines": ([BAND], 2.0),
    "step disturbance, its transfer alone": ([STEP], 0.5),
    "sum of sine and step, with them": ([SINE, STEP], 1.0),
    "disturbance from a CSV file": ([CSV], 1.0),
    "payload that is dropped, its transfer alone": ([DROP], 0.5),
}
"""What disturbs → disturbances beside the PD, and target of a communication step [µs]; each includes one more input of the plant."""

LOOPS: Mapping[str, tuple[Sequence[dict[str, Any]], str | None, float]] = {
    "PD": ([PD], None, 1.0),
    "H-infinity of order 32": ([H_INFINITY], None, 2.0),
    "cascade of three loops": ([CASCADE], None, 1.5),
    "PD with scheduled gains": ([{**PD, "schedule": SCHEDULE}], None, 1.0),
    "PID": ([{**PD, "kind": "pid", "integral": 1e4}], None, 1.0),
    "rigid feedforward": ([PD, FEEDFORWARD], "PD", 1.0),
    "flexible feedforward": ([PD, {**FEEDFORWARD, "robot": "flexible"}], "PD", 1.0),
    "linear system of order 2, python-control's too": ([PD, LINEAR], "PD", 1.0),
    "gravity feedforward": ([PD, GRAVITY], "PD", 1.0),
    "friction compensation": ([PD, FRICTION], "PD", 1.0),
    "sum of two feedforwards, with them": ([PD, GRAVITY, FRICTION], "PD", 2.0),
    "disturbance observer, an inertia": ([PD, {**OBSERVER, "inertia": 0.15}], "PD", 1.0),
    "disturbance observer, the rigid robot": ([PD, OBSERVER], "PD", 2.0),
}
"""What is sampled → controllers, the entry whose time is taken off (None: the plant alone), and target [µs]."""


INLINE: Mapping[str, tuple[Mapping[str, Sequence[dict[str, Any]]], float]] = {
    "notch on both torques": ({"filter": [{"kind": "notch", "frequency": 60.0}]}, 1.0),
    "biquad on both torques": (
        {"filter": [{"kind": "biquad", "numerator": [1.0, 20.0, 9e4], "denominator": [1.0, 500.0, 9e4]}]},
        1.0,
    ),
    "high-pass on both velocities": ({"filter": [{"kind": "high-pass", "frequency": 2.0, "signal": "velocity"}]}, 1.0),
    "low-pass of order 4 on both velocities": (
        {"filter": [{"kind": "low-pass", "frequency": 300.0, "order": 4, "signal": "velocity"}]},
        1.0,
    ),
    "lead-lag on both torques": ({"filter": [{"kind": "lead-lag", "zero": 30.0, "pole": 120.0}]}, 1.0),
    "setpoint filter on six references": (
        {"filter": [{"kind": "low-pass", "frequency": 60.0, "signal": "reference"}]},
        1.0,
    ),
    "dead zone": ({"imperfection": [{"kind": "dead-zone", "half_width": 0.1}]}, 1.0),
    "backlash": ({"imperfection": [{"kind": "backlash", "signal": "position", "gap": 1e-5}]}, 1.0),
    "delay of 2.3 samples": ({"imperfection": [{"kind": "delay", "time": 5.75e-4}]}, 1.0),
    "known delay of both positions and their references": (
        {"imperfection": [{"kind": "delay", "signal": "position", "time": 5e-4, "known": True}]},
        2.0,
    ),
    "encoder over 2 samples": ({"imperfection": [{"kind": "encoder", "counts_per_turn": 1e5, "window": 2}]}, 1.0),
    "quantisation": ({"imperfection": [{"kind": "quantisation", "resolution": 0.01}]}, 1.0),
    "saturation": ({"imperfection": [{"kind": "saturation", "limit": 80.0}]}, 1.0),
    "rate limit": ({"imperfection": [{"kind": "rate-limit", "rate": 5e4}]}, 1.0),
    "lag, sampled": ({"imperfection": [{"kind": "lag", "time_constant": 1e-3, **TIME}]}, 1.0),
    "normal noise on both positions": (
        {"imperfection": [{"kind": "noise", "signal": "position", "standard_deviation": 1e-5}]},
        3.0,
    ),
    "jitter": ({"imperfection": [{"kind": "jitter", "signal": "velocity", "time": 1e-4}]}, 2.5),
}
"""What is in series with signals → tables of the scene beside the PD, and target [µs]; its transfers count."""


def looped(controllers: Sequence[dict[str, Any]], idle: Path, tables: Mapping[str, Sequence[dict[str, Any]]]) -> Timed:
    """A run of a plant that does nothing under the controllers of a scene and what other tables of it make."""
    loop = loop_of(
        DRIVEN.replace({"controller": list(controllers), **{key: list(each) for key, each in tables.items()}})
    )
    references, plant = TrajectorySlave(loop.driving), FmuSlave(idle, "plant", output_order=0)
    wiring = wire(references, plant, loop.controllers, loop.inline_blocks, loop.connect, loop.disturbances)
    inline = [each.slave for each in loop.inline_blocks]
    system = connect([references, plant, *loop.controllers, *inline, *loop.disturbances], wiring.connections)
    record = Selection(["plant.joint1.position"], order=0)
    simulator = Simulator(system, SECONDS, TIME["sample_time"], record=record)
    if (result := simulator.run()).outcome is not Outcome.COMPLETED:
        raise SystemExit(result.message)
    return timed(simulator.run)


def controller_figures() -> Iterator[SpeedFigure]:
    """All lines: the run's time beyond that of the entry named, for each sample."""
    beside_pd = {what: ({"disturbance": each}, target) for what, (each, target) in DISTURBED.items()} | dict(INLINE)
    with tempfile.TemporaryDirectory(prefix="flexfmu-controllers-") as name:
        idle = idle_fmu(build_scene(DRIVEN.replace({"disturbance": [DROP]})).path, Path(name))
        runs = [looped([], idle, {}), *(looped(controllers, idle, {}) for controllers, _, _ in LOOPS.values())]
        runs += [looped([PD], idle, tables) for tables, _ in beside_pd.values()]
        times = dict(zip([None, *LOOPS, *beside_pd], best_times(runs, ROUNDS), strict=True))
    targets = {what: (base, target) for what, (_, base, target) in LOOPS.items()}
    targets |= {what: ("PD", target) for what, (_, target) in beside_pd.items()}
    for what, (base, target) in targets.items():
        cost = (times[what] - times[base]) * TIME["sample_time"] / SECONDS
        yield SpeedFigure(f"{what}, a sample", 1e6 * cost, target, "µs")
