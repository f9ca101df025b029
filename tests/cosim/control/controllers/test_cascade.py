"""Cascades, PD and PID: closed forms, anti-windup, several rates against a simulation of its own, and what is refused."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import control
import numpy as np
import pytest
from axis_slave import Axis
from blocks import cascade, pd, pid, responses
from numpy.typing import NDArray
from python_slave import PythonSlave

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, Sampled, Slave, SlaveVariable
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]

H = 1e-3
LOOP, CURRENT = {"proportional": 1.0}, {"time_constant": 1e-3}
BACK_CALCULATION = {"kind": "back-calculation", "tracking_time": 0.01}


def test_velocity_loop_is_its_transfer_function() -> None:
    """P and the trapezoidal I against `control.forced_response`, with the torque of the reference acceleration and a feedforward."""
    k_p, k_i, inertia = 40.0, 3e3, 0.3
    rng = np.random.default_rng(2)
    error, acceleration, feedforward = rng.normal(size=(3, 300))
    error[0] = 0.0
    velocity = {"proportional": k_p, "integral": k_i, "inertia": inertia}
    block = cascade(LOOP, velocity, CURRENT, sample_time=H, initial=(0.0, 0.0))[1]
    inputs = {"joint1.command.velocity": 0.5 * error, "joint1.velocity": -0.5 * error}
    inputs |= {"joint1.reference.acceleration": acceleration, "joint1.feedforward": feedforward}
    found = responses(block, inputs)["joint1.command.torque"]
    integral = control.tf([k_i * H / 2.0, k_i * H / 2.0], [1.0, -1.0], H)
    summed = control.forced_response(integral, H * np.arange(error.size), error).outputs
    expected = k_p * error + summed + inertia * acceleration + feedforward
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * abs(expected).max())


@pytest.mark.parametrize("time_constant", [0.0, 2e-4, 5e-3])
def test_current_loop_is_a_lag(time_constant: float) -> None:
    """y(k) = c + (y0 - c) exp(-k h / T) for a constant command c, which is limited; a delay of one sample with T = 0."""
    current = {"time_constant": time_constant}
    block = cascade(LOOP, LOOP, current, torque_limit=8.0, sample_time=H, initial=(3.0, 0.0))[2]
    k = np.arange(40)
    fading = np.exp(-k * H / time_constant) if time_constant else (k == 0).astype(float)
    for command in (5.0, 11.0, -20.0):
        target = float(np.clip(command, -8.0, 8.0))
        found = responses(block, {"joint1.command.torque": np.full(k.size, command)})["joint1.torque"]
        np.testing.assert_allclose(found, target + (3.0 - target) * fading, rtol=1e-12, atol=1e-13)
    assert block.feedthrough["joint1.torque"] == ()


class Motion(PythonSlave):
    """References of an axis: a sine, and a ramp from 0.1 s on, with their derivatives."""

    name = "motion"
    variables = tuple(
        SlaveVariable(f"joint1.reference.{kind}", "output") for kind in ("position", "velocity", "acceleration")
    )

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = np.array(self.at(self.time))[indices]

    @staticmethod
    def at(time: float) -> tuple[float, float, float]:
        """Position, velocity, acceleration."""
        rate = 30.0
        ramp = max(0.0, time - 0.1)
        return (
            np.sin(rate * time) + 5.0 * ramp,
            rate * np.cos(rate * time) + 5.0 * (ramp > 0.0),
            -(rate**2) * np.sin(rate * time),
        )


AXIS = Axis()

GAINS = {"K_v": 45.0, "V": 0.8, "limit": 18.0, "K_p": 9.0, "K_i": 400.0, "J": 0.15, "T": 4e-4}


def blocks_of(clocks: Mapping[str, tuple[Fraction, Fraction]], anti_windup: Any) -> tuple[SymbolicBlock, ...]:
    """The three loops of one joint with the gains above, and torques up to 60 N.m."""
    at = {kind: {"sample_time": float(clock[0]), "offset": float(clock[1])} for kind, clock in clocks.items()}
    g, rest = GAINS, {"torque_limit": 60.0, "anti_windup": anti_windup, "sample_time": 1.0, "initial": (0.0, 0.0)}
    position = {"proportional": g["K_v"], "velocity_feedforward": g["V"], "velocity_limit": g["limit"]}
    velocity = {"proportional": g["K_p"], "integral": g["K_i"], "inertia": g["J"]}
    loops = {"position": position, "velocity": velocity, "current": {"time_constant": g["T"]}}
    found: tuple[SymbolicBlock, ...] = cascade(*(keys | at[kind] for kind, keys in loops.items()), **rest)
    return found


def own_simulation(clocks: Mapping[str, tuple[Fraction, Fraction]], stop: Fraction, rule: str) -> Array:
    """(N, 4) time, angle, rate and torque at all instants: the formulas of the cascade by hand, instants as fractions.

    Before its first sample a loop holds what it has computed at the start from its start states.
    """
    g, limit = GAINS, 60.0
    instants = {
        kind: {offset + k * h for k in range(int((stop - offset) / h) + 1)} for kind, (h, offset) in clocks.items()
    }
    angle = rate = torque = integral = last = 0.0
    started, lag = False, 0.0
    q_r, w_r, a_r = Motion.at(0.0)
    # what initialisation leaves: outputs of the start states
    command = np.clip(g["K_v"] * (q_r - angle) + g["V"] * w_r, -g["limit"], g["limit"])
    wanted = np.clip(g["K_p"] * (command - rate) + g["J"] * a_r, -limit, limit)
    rows, before = [], Fraction(0)
    for now in sorted(set.union(*instants.values())):
        angle, rate = AXIS.moved(angle, rate, torque, float(now - before))
        q_r, w_r, a_r = Motion.at(float(now))
        if now in instants["position"]:
            command = np.clip(g["K_v"] * (q_r - angle) + g["V"] * w_r, -g["limit"], g["limit"])
        if now in instants["velocity"]:
            h, error = float(clocks["velocity"][0]), command - rate
            grown = g["K_i"] * h / 2.0 * (error + last) if started else 0.0
            rest = g["K_p"] * error + g["J"] * a_r
            total = rest + integral + grown
            wanted = np.clip(total, -limit, limit)
            if rule == "clamping" and (total - wanted) * grown > 0.0:
                grown = 0.0
                wanted = np.clip(rest + integral, -limit, limit)
            integral += grown
            if rule == "back-calculation":
                integral += (1.0 - np.exp(-h / 0.01)) * (wanted - total)
            started, last = True, error
        if now in instants["current"]:
            torque, lag = lag, wanted + np.exp(-float(clocks["current"][0]) / g["T"]) * (lag - wanted)
        rows.append((float(now), angle, rate, torque))
        before = now
    return np.array(rows)


MS = Fraction(1, 1000)
CLOCKS = {
    "one rate": {"position": (MS, 0 * MS), "velocity": (MS, 0 * MS), "current": (MS, 0 * MS)},
    "multiples": {"position": (MS, 0 * MS), "velocity": (MS / 4, 0 * MS), "current": (MS / 16, 0 * MS)},
    "offsets": {"position": (MS, MS / 3), "velocity": (MS / 4, MS / 10), "current": (MS / 16, MS / 40)},
    "no multiples": {"position": (2 * MS, MS / 2), "velocity": (3 * MS / 4, 0 * MS), "current": (MS / 7, MS / 10)},
}


RULES = {each: each for each in ("clamping", "none")} | {"back-calculation": BACK_CALCULATION}


@pytest.mark.parametrize(
    ("clocks", "rule"),
    [*((each, "clamping") for each in CLOCKS), ("no multiples", "back-calculation"), ("no multiples", "none")],
)
def test_several_rates_against_a_simulation_of_its_own(clocks: str, rule: str) -> None:
    """Three clocks, both limits reached, every anti-windup: angle, rate and torque to 1e-12 at every instant."""
    times = CLOCKS[clocks]
    stop = 250 * MS
    slaves: list[Slave] = [Motion(), AXIS, *(BlockSlave(each) for each in blocks_of(times, RULES[rule]))]
    owners = {"motion": slaves[0], "plant": slaves[1]} | {each.name: each for each in slaves[2:]}
    outputs = {v.name: f"{n}.{v.name}" for n, each in owners.items() for v in each.variables if v.causality == "output"}
    wires = [
        (outputs[v.name], f"{n}.{v.name}")
        for n, each in owners.items()
        for v in each.variables
        if v.causality == "input" and v.name in outputs
    ]
    result = simulate(connect(slaves, wires), stop=float(stop), step=float(MS / 3))
    assert result.outcome is Outcome.COMPLETED, result.message
    time, exact = result.recording.time, own_simulation(times, stop, rule)
    # the last recorded value of each instant is that after its samples
    rows = np.searchsorted(time, exact[:, 0] + 1e-9) - 1
    np.testing.assert_allclose(time[rows], exact[:, 0], rtol=0.0, atol=1e-15)
    for column, name in ((1, "plant.joint1.position"), (2, "plant.joint1.velocity"), (3, "current.joint1.torque")):
        scale = abs(exact[:, column]).max()
        np.testing.assert_allclose(
            result.recording[name].values[rows], exact[:, column], rtol=0.0, atol=1e-12 * scale, err_msg=name
        )
    assert abs(exact[:, 3]).max() > 59.0, "the torque reaches its limit"


LOOPS: dict[str, Any] = {
    "kind": "cascade",
    "sample_time": 1e-3,
    "offset": 2e-4,
    "torque_limit": [80.0, 90.0],
    "position": {"proportional": 60.0, "velocity_limit": 12.0},
    "velocity": {"proportional": 120.0, "integral": 6e3, "sample_time": 2.5e-4, "offset": 0.0},
    "current": {"time_constant": 2e-4, "sample_time": 6.25e-5},
}


def loop_with(robot: Any, **changes: Any) -> tuple[Slave, ...]:
    """The controllers of the paper's robot with the cascade above, changed."""
    return loop_of(robot.replace({"controller": [{**LOOPS, **changes}]})).controllers


@pytest.fixture(scope="module")
def robot() -> Any:
    """Rigid, driven by torques."""
    rigid = {"effects.proximal_bending": 0, "effects.distal_axial": 0, "effects.motor_inertia": 0.1}
    return load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", **rigid})


def test_loops_of_a_scene(robot: Any) -> None:
    """Their names, their clocks, which are those of the controller unless they have their own, and the limits of both inner loops."""
    _, velocity, current = slaves = loop_with(robot)
    assert [each.name for each in slaves] == ["cascade_position", "cascade_velocity", "cascade_current"]
    assert all(isinstance(each, Sampled) for each in slaves)
    clocks = [(each.sample_time, each.offset) for each in slaves if isinstance(each, BlockSlave)]
    assert clocks == [(1e-3, 2e-4), (2.5e-4, 0.0), (6.25e-5, 2e-4)]
    for slave in (velocity, current):
        limits = {each.name: each.start for each in slave.variables if "imum" in each.name}
        expected = {"joint1.torque.minimum": -80.0, "joint2.torque.minimum": -90.0}
        assert limits == expected | {"joint1.torque.maximum": 80.0, "joint2.torque.maximum": 90.0}
    # without a current loop the command is the torque
    outputs = {each.name for each in loop_with(robot, current=None)[1].variables if each.causality == "output"}
    assert outputs == {"joint1.torque", "joint2.torque"}
    # the current loop starts from the torques that hold the robot
    initial = [each.start for each in current.variables if each.name.endswith("initial")]
    assert all(each != 0.0 for each in initial)


def test_filters_have_the_clock_of_the_loop_that_exchanges_their_signal(robot: Any) -> None:
    """Positions and references that of the position loop, velocities and encoders that of the velocity loop, torques the current loop's."""
    tables = [
        {"kind": "low-pass", "frequency": 100.0, "signal": each, "name": f"of_{each}"}
        for each in ("position", "reference", "velocity", "torque")
    ]
    scene = robot.replace(
        {"controller": [LOOPS], "filter": tables, "imperfection": [{"kind": "encoder", "counts_per_turn": 1e5}]}
    )
    found = {each.slave.name: each.slave.sample_time for each in loop_of(scene).inline_blocks}  # type: ignore[attr-defined]
    expected = {"of_position": 1e-3, "of_reference": 1e-3, "of_velocity": 2.5e-4, "of_torque": 6.25e-5}
    assert found == expected | {"encoder": 2.5e-4}


def test_connections_of_a_cascade_reach_its_loops(robot: Any) -> None:
    """`connect` names inputs of any of the three."""
    scene = robot.replace({"controller": [{**LOOPS, "connect": {"joint1.velocity": "joint2.velocity"}}]})
    assert dict(loop_of(scene).connect) == {"cascade_velocity.joint1.velocity": "joint2.velocity"}


@pytest.mark.parametrize(("changes", "message"), [
    ({"position": {"proportional": -1.0}}, r"position.proportional.*must be at least 0\.0"),
    ({"position": {}}, r"position.proportional"),
    ({"velocity": {"proportional": 1.0, "integral": float("nan")}}, r"velocity.integral"),
    ({"velocity": {"proportional": 1.0, "sample_time": 0.0}}, r"velocity.sample_time.*above 0"),
    ({"current": {"time_constant": 1e-4, "offset": -1.0}}, r"current.offset.*must be at least 0\.0"),
    ({"current": {"bandwidth": 1e3}}, r"current.bandwidth"),
])  # fmt: skip
def test_scenes_are_refused(robot: Any, changes: dict[str, Any], message: str) -> None:
    """The key, its value and what would be right."""
    with pytest.raises(SceneError, match=message):
        robot.replace({"controller": [{**LOOPS, **changes}]})


TIME = H * np.arange(400)


def test_pd_is_its_formula() -> None:
    """Every joint has its own gains, errors and feedforward."""
    rng = np.random.default_rng(0)
    model = pd([50.0, 70.0], [2.0, 3.0], sample_time=H)
    signals = {variable.name: rng.normal(size=20) for variable in model.inputs}
    torque = responses(model, signals)
    for joint, k_p, k_d in (("joint1", 50.0, 2.0), ("joint2", 70.0, 3.0)):
        expected = (
            k_p * (signals[f"{joint}.reference.position"] - signals[f"{joint}.position"])
            + k_d * (signals[f"{joint}.reference.velocity"] - signals[f"{joint}.velocity"])
            + signals[f"{joint}.feedforward"]
        )
        np.testing.assert_allclose(torque[f"{joint}.torque"], expected, rtol=1e-14, atol=1e-13)


@pytest.mark.parametrize("filter_time", [0.0, 5e-4, 8e-3])
def test_pid_is_its_transfer_function(filter_time: float) -> None:
    """The triangle-hold equivalent of I and filtered D, against `control.forced_response`, to rounding."""
    k_p, k_i, k_d = 40.0, 300.0, 2.0
    a = np.exp(-H / filter_time) if filter_time else 0.0
    integral = control.tf([k_i * H / 2.0, k_i * H / 2.0], [1.0, -1.0], H)
    derivative = control.tf([k_d * (1.0 - a) / H, -k_d * (1.0 - a) / H], [1.0, -a], H)
    error = np.random.default_rng(2).normal(size=TIME.size)
    error[0] = 0.0
    model = pid(k_p, k_i, k_d, sample_time=H, filter_time=filter_time)
    found = responses(model, {"joint1.reference.position": error})["joint1.torque"]
    parts = [control.forced_response(each, TIME, error).outputs for each in (integral, derivative)]
    np.testing.assert_allclose(found, k_p * error + parts[0] + parts[1], rtol=1e-12, atol=1e-12 * abs(found).max())


def test_first_samples_and_weights() -> None:
    """A start away from the reference gives the proportional torque and the initial one, no derivative impulse; with setpoint and
    derivative weight zero a jump of the reference moves the integral alone."""
    for weight in (1.0, 0.0):
        model = pid(10.0, 5.0, 3.0, sample_time=H, initial_torque=2.0, setpoint_weight=weight)
        torque = responses(model, {"joint1.reference.position": [1.0, 1.0]})["joint1.torque"]
        np.testing.assert_allclose(torque, [12.0, 12.0 + 5.0 * H], rtol=1e-14)
    model = pid(10.0, 5.0, 3.0, sample_time=H, setpoint_weight=0.0, derivative_weight=0.0)
    torque = responses(model, {"joint1.reference.position": [0.0, 1.0, 1.0]})["joint1.torque"]
    np.testing.assert_allclose(torque, [0.0, 2.5 * H, 7.5 * H], rtol=1e-14, atol=1e-17)


def test_weights_know_no_origin_of_angles() -> None:
    """Angles that count from elsewhere change no torque, and at the reference the first one is the initial one: drawn laws."""
    rng = np.random.default_rng(4)
    rules = ("clamping", {"kind": "back-calculation", "tracking_time": 0.01}, "none")
    for case in range(30):
        law = {
            "setpoint_weight": rng.choice([0.0, rng.uniform(0.0, 1.5)]),
            "filter_time": rng.choice([0.0, 2e-3]),
            "torque_limit": 40.0 if case % 2 else None,
            "anti_windup": rules[case % 3],
            "initial_torque": rng.uniform(-30.0, 30.0),
            "schedule": {"over": "load", "at": [0.0, 1.0], "proportional": [0.5, 1.0]} if case % 5 == 0 else None,
        }
        model = pid(rng.uniform(1.0, 1e3), rng.uniform(0.0, 1e3), rng.uniform(0.0, 5.0), sample_time=H, **law)
        angles = rng.normal(scale=0.02, size=(2, 20)).cumsum(axis=1)
        angles[:, 0] = 0.0
        near, far = (
            responses(model, {"joint1.reference.position": angles[0] + origin, "joint1.position": angles[1] + origin})
            for origin in (0.0, rng.uniform(-4.0, 4.0))
        )
        assert far["joint1.torque"][0] == pytest.approx(law["initial_torque"], abs=1e-9)
        # where a torque is exactly at its limit, rounding decides whether the integral moves
        np.testing.assert_allclose(far["joint1.torque"], near["joint1.torque"], rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("tracking_time", [0.02, 0.0])
def test_back_calculation_is_exact(tracking_time: float) -> None:
    """With a constant error the excess over the limit follows its differential equation's held solution."""
    k_i, a = 10.0, np.exp(-H / tracking_time) if tracking_time else 0.0
    rule = {"kind": "back-calculation", "tracking_time": tracking_time}
    slave = BlockSlave(pid(5.0, k_i, 0.0, sample_time=H, torque_limit=1.0, anti_windup=rule))
    slave.initialize(0.0, 1.0, None)
    slave.set(np.array([0]), np.array([1.0]))
    carried = 0.0
    for k in range(200):
        slave.sample(k * H)
        now = 4.0 + carried + (k_i * H if k else 0.0)
        carried = a * now - 4.0
        assert 5.0 + slave.save()[-18:][1] - 1.0 == pytest.approx(a * now, rel=1e-12, abs=1e-14)
    assert a * now == pytest.approx(k_i * H * a / (1.0 - a), rel=1e-3)
