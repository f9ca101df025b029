"""FMUs for model exchange only as slaves: their states against closed forms, their events at the instants of these."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from math import exp, inf, sqrt
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import InputError, SlaveError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, simulate
from flexfmu.cosim.engine.master.system import System, connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.cosim.exchange.wrap import wrap_fmu
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.file import load_scene

GRAVITY, RESTITUTION = 9.81, 0.8


def exchange_alone(path: Path, folder: Path) -> Path:
    """An FMU without its description of co-simulation."""
    target = folder / path.name
    with zipfile.ZipFile(path) as built, zipfile.ZipFile(target, "w") as archive:
        for name in built.namelist():
            content = built.read(name)
            if name == "modelDescription.xml":
                without = re.sub(
                    r"<CoSimulation\b(?:[^>]*/>|.*?</CoSimulation>)", "", content.decode(), flags=re.DOTALL
                )
                content = without.encode()
            archive.writestr(name, content)
    return target


def run(path: Path, stop: float, step: float, tolerance: float = 1e-6, **parameters: Any) -> Simulation:
    """The FMU alone."""
    result = simulate(connect([FmuSlave(path, "guest", parameters)], []), stop=stop, step=step, tolerance=tolerance)
    assert result.outcome is Outcome.COMPLETED, result.message
    return result


class Polynomial:
    """A source with two outputs: 1 + 2 t + 3 t^2 with its derivatives, and the number of seconds, which jumps."""

    name = "source"
    variables = (SlaveVariable("u", "output"), SlaveVariable("d", "output", discrete=True, type="Integer"))
    feedthrough = {"u": (), "d": ()}  # noqa: RUF012
    max_output_order = 2
    time = 0.0

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.time = start_time

    def set(self, indices: Indices, values: RealArray) -> None: ...

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = np.array([1.0 + 2.0 * self.time + 3.0 * self.time**2, float(int(self.time + 1e-9))])[indices]

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        derivatives[:] = np.array([[2.0 + 6.0 * self.time, 0.0], [6.0, 0.0]])[: len(derivatives), indices]

    def step(self, time: float, step: float) -> None:
        self.time = time + step


def driven(path: Path, **parameters: Any) -> System:
    """The FMU of another tool behind the source."""
    wires = [("source.u", "guest.u"), ("source.d", "guest.d")]
    return connect([Polynomial(), FmuSlave(path, "guest", parameters)], wires)


@pytest.fixture(scope="module")
def make_exchange(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes the FMU for model exchange of another tool."""
    from foreign_fmu import maker

    return maker(tmp_path_factory.mktemp("exchange"), "exchange", "exchange.xml")


@pytest.fixture(scope="module", params=["2", pytest.param("3", marks=pytest.mark.slow)])
def plant(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bouncing ball; and a state that is slow behind a fast one, slow' = u - slow^2 but for 1e-6."""
    model = flexfmu.ode(
        "plant",
        x={"height": 1.0, "rate": 0.0, "slow": 1.0, "fast": 1.0},
        u={"u": 0.5},
        p={"e": RESTITUTION},
        rhs=lambda x, u: [x.rate, -GRAVITY, u.u - x.fast, 1e6 * (x.slow * x.slow - x.fast)],
        events={"bounce": flexfmu.event(lambda x: x.height, -1, lambda x, p: {"rate": -p.e * x.rate})},
    )
    return exchange_alone(build_fmu(model, fmi=request.param).path, tmp_path_factory.mktemp("plant"))


def test_a_ball_bounces_at_the_closed_form_s_instants(plant: Path) -> None:
    """Heights, rates and energy of a ball are those of its parabolas, whatever the communication step; our FMUs shift their event
    indicators by 1e-9 to keep them from zero. A height's derivative is its rate."""
    fall = sqrt(2.0 / GRAVITY)
    bounces = fall + np.concatenate([[0.0], np.cumsum(2.0 * fall * RESTITUTION ** np.arange(1, 8))])
    for step in (0.01, 0.4):
        recording = run(plant, 2.4, step).recording
        time, height, rate = recording.time, recording["guest.height"].values, recording["guest.rate"].values
        past = np.searchsorted(bounces, time)
        since = time - np.where(past > 0, bounces[past - 1], 0.0)
        up = np.where(past > 0, GRAVITY * fall * RESTITUTION**past, 0.0)
        parabolas = np.where(past > 0, 0.0, 1.0) + up * since - GRAVITY * since**2 / 2
        np.testing.assert_allclose(height, parabolas, atol=3e-8, rtol=0.0)
        energy = GRAVITY * RESTITUTION ** (2 * past)
        np.testing.assert_allclose(GRAVITY * height + rate**2 / 2, energy, atol=1e-6, rtol=0.0)
        np.testing.assert_array_equal(recording["guest.height"].first, rate)


def test_a_hidden_stiff_plant_and_the_tolerance(plant: Path) -> None:
    """A rate of 1e6 1/s behind a slow one costs neither accuracy nor steps; the error follows the tolerance."""
    root, errors = sqrt(0.5), []
    for tolerance in (1e-3, 1e-6, 1e-9):
        recording = run(plant, 1.0, 0.25, tolerance).recording
        share = (1.0 - root) / (1.0 + root) * np.exp(-2.0 * root * recording.time)
        errors.append(abs(recording["guest.slow"].values - root * (1.0 + share) / (1.0 - share)).max())
    assert errors[0] < 1e-3
    # the fast rate's own share
    assert max(errors[1:]) < 3e-6


def test_states_that_are_no_outputs_are_recorded(make_exchange: Callable[..., Path]) -> None:
    """A local state of another tool's FMU is recorded with its derivative, x' = -2 x."""
    hidden = (
        ('"x" valueReference="0" causality="output"', '"x" valueReference="0"'),
        ('<Unknown index="1" dependencies=""/>', ""),
    )
    state = run(make_exchange(*hidden), 0.2, 0.1, 1e-8, rate=2.0).recording["guest.x"]
    np.testing.assert_allclose(state.values, np.exp(-2.0 * np.array([0.0, 0.1, 0.2])), rtol=1e-8)
    assert state.first is not None
    np.testing.assert_allclose(state.first, -2.0 * state.values, rtol=1e-15)


def test_time_events_step_events_and_discarded_steps(make_exchange: Callable[..., Path]) -> None:
    """States that jump at time events of two rounds are met exactly, between communication points too, whether or not the FMU
    discards all but short steps; a step event is one event."""
    for patience in (1.0, 0.013):
        recording = run(make_exchange(), 1.1, 0.1, 1e-8, rate=2.0, patience=patience).recording
        expected = [
            exp(-2.0 * t) + sum(exp(-2.0 * (t - 0.25 * k)) for k in range(1, 5) if 0.25 * k <= t + 1e-9)
            for t in recording.time
        ]
        np.testing.assert_allclose(recording["guest.x"].values, expected, rtol=1e-8)
        np.testing.assert_array_equal(recording["guest.ticks"].values, np.floor(recording.time / 0.25 + 1e-9))
        np.testing.assert_array_equal(recording["guest.steps"].values, recording.time > 0.6 - 1e-9)
    never = FmuSlave(make_exchange(), "guest", {"patience": 0.0})
    never.initialize(0.0, 1.0, None)
    with pytest.raises(SlaveError, match="fmi2Discard"):
        never.step(0.0, 0.1)
    never.terminate()


def test_inputs_follow_their_derivatives_and_jump_at_events(make_exchange: Callable[..., Path]) -> None:
    """x' = u - x with u = 1 + 2 t + 3 t^2 is that of the polynomial, not of held values; the discrete input arrives at events."""
    result = simulate(driven(make_exchange()), stop=1.2, step=0.1, tolerance=1e-9)
    assert result.outcome is Outcome.COMPLETED, result.message
    time = result.recording.time
    expected = 5.0 - 4.0 * time + 3.0 * time**2 - 4.0 * np.exp(-time)
    jumps = [sum(exp(0.25 * k - t) for k in range(1, 5) if 0.25 * k <= t + 1e-9) for t in time]
    np.testing.assert_allclose(result.recording["guest.x"].values, expected + jumps, rtol=1e-8)
    assert result.recording["guest.shown"].values[-1] == 1.0


@pytest.mark.slow
def test_a_wrapped_fmu_is_co_simulated(make_exchange: Callable[..., Path], tmp_path: Path) -> None:
    """An FMU for model exchange with the integrator in it has, in another tool, the states of our master: time events, step events
    and a discrete input that arrives at an event included."""
    path, target = make_exchange(), tmp_path / "wrapped.fmu"
    outcome = CliRunner().invoke(app, ["wrap", str(path), "-o", str(target)])
    assert outcome.exit_code == 0, outcome.stderr
    given = {"rate": 2.0, "patience": 0.013}
    mine = run(path, 1.0, 0.1, 1e-8, **given).recording
    found = fmpy.simulate_fmu(
        str(target),
        stop_time=1.0,
        output_interval=0.1,
        relative_tolerance=1e-8,
        start_values=given,
        input=np.array([(0.0, 0), (0.4, 0), (0.4, 4)], dtype=[("time", float), ("d", int)]),
        output=["x", "ticks", "steps", "shown"],
    )
    for name in ("x", "ticks", "steps"):
        values = mine[f"guest.{name}"].values[np.searchsorted(mine.time, found["time"] - 1e-9)]
        np.testing.assert_allclose(found[name], values, rtol=1e-9)
    np.testing.assert_array_equal(found["shown"], 4.0 * (found["time"] > 0.4 + 1e-9))
    with pytest.raises(InputError, match=r"for co-simulation; only one of FMI 2\.0 for model exchange alone"):
        wrap_fmu(target, tmp_path / "again.fmu")


def test_rollback_is_exact(plant: Path) -> None:
    """From a saved state the same steps, with an event, have the same bits."""
    slave, ends = FmuSlave(plant, "guest"), np.empty((2, 4))
    places = np.array([i for i, each in enumerate(slave.variables) if each.causality == "output"])
    assert slave.can_save
    slave.initialize(0.0, inf, 1e-6)
    slave.step(0.0, 0.3)
    state = slave.save()
    for row in ends:
        slave.step(0.3, 0.5)
        slave.step(0.8, 0.5)
        slave.get(places[:4], row)
        slave.restore(state)
    slave.terminate()
    np.testing.assert_array_equal(*ends)


@pytest.mark.slow
def test_two_integrators_agree_on_the_robot(tmp_path: Path) -> None:
    """Torques of the flexible robot along its motion, whose derivatives are inputs, are those of its co-simulation."""
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.tolerance": 1e-9, "trajectory.dwell": 0.01})
    path = exchange_alone(flexfmu.build(scene, fmi="3"), tmp_path)
    mine, other = (flexfmu.run(scene, fmu=each).recording for each in (None, path))
    for name in ("joint1.torque", "joint2.torque"):
        largest = abs(mine[name].values).max()
        np.testing.assert_allclose(other[name].values, mine[name].values, atol=1e-10 * largest, rtol=0.0)
