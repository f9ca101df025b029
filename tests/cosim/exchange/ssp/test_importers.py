"""Other people's importers run an exported scene and agree with our master to first order in the step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy.ssp.simulation
import numpy as np
import pytest
from ssp_support.importers import SIGNAL, simulate
from ssp_support.loops import INSTANTS, SAMPLE_TIME, export_loop, in_our_master, off
from ssp_support.loops import STEPS as LOOP_STEPS

from flexfmu.cosim.exchange.ssp.loading import load_ssp

SspOf = Callable[[str], Path]

STEPS = (4e-4, 2e-4)
INSTANT = 0.2
"""In the middle of the motion [s]."""


@pytest.fixture(scope="session")
def reference(ssp_of: SspOf) -> float:
    """Position at the instant, by our master with derivatives of all orders."""
    recording = load_ssp(ssp_of("motion"), stop=INSTANT).simulate().recording
    return float(recording[f"plant.{SIGNAL}"].values[-1])


def at_the_instant(tool: str, path: Path, step: float) -> float:
    """The position at the instant, in another tool."""
    return float(simulate(tool, path, step, [INSTANT])[0])


OTHERS = ["libcosimpy", "ecospy", "OMSimulator"]


@pytest.mark.parametrize("tool", ["fmpy", *(pytest.param(each, marks=pytest.mark.slow) for each in OTHERS)])
def test_other_importers(tool: str, ssp_of: SspOf, reference: float) -> None:
    """fmpy (started from the FMUs' outputs), libcosim, ecos and OMSimulator read the file as it is; halving the step halves the
    error, which is that of references that are one or two steps old."""
    errors = [abs(at_the_instant(tool, ssp_of("motion"), step) - reference) for step in STEPS]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)
    assert errors[1] < 1e-3


def test_fmpy_as_it_is(ssp_of: SspOf) -> None:
    """The first step with zeros at all inputs kicks the robot; it still arrives."""
    result = fmpy.ssp.simulation.simulate_ssp(ssp_of("motion"), stop_time=0.43, step_size=STEPS[0])
    assert np.isfinite(result[f"plant.{SIGNAL}"]).all()
    assert result[f"plant.{SIGNAL}"][-1] == pytest.approx(0.175, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("tool", OTHERS)
@pytest.mark.parametrize("name", ["staggered", "drive"])
def test_controllers_in_other_importers(tool: str, name: str, ssp_of: SspOf) -> None:
    """Controllers, shaper, encoder and amplifier, and all loops of a drive: each samples a communication step after those that feed it, so that
    what passes signals on a step late is in time."""
    path = ssp_of(name)
    recording = load_ssp(path, stop=INSTANT).simulate().recording
    expected = float(recording[f"plant.{SIGNAL}"].values[-1])
    for step in (5e-5, 2.5e-5):
        assert at_the_instant(tool, path, step) == pytest.approx(expected, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "tools"),
    [
        ("PD", ["libcosimpy", "ecospy", "fmpy"]),
        ("PID", ["libcosimpy", "ecospy", "fmpy"]),
        ("PD, encoder, window 1", ["libcosimpy", "ecospy"]),
        ("PD, encoder, window 4", ["libcosimpy", "ecospy"]),
        ("PID, encoder", ["libcosimpy", "ecospy"]),
        ("PID, encoder, offset", ["libcosimpy", "ecospy", "fmpy"]),
    ],
)
def test_torque_driven_loops(name: str, tools: list[str], tmp_path: Path) -> None:
    """A controller's torque comes a communication step late, an error of first order in the step. Behind an encoder that
    samples at the same instants measurements are a sample late, by which the robot is ahead; with an offset they aren't."""
    path = export_loop(name, tmp_path)
    exact = in_our_master(path)
    speed = np.abs(np.diff(exact)).max() / (INSTANTS[1] - INSTANTS[0])
    is_late = "encoder" in name and "offset" not in name
    for tool in tools:
        wide, narrow = (off(tool, path, step, exact).max() for step in (LOOP_STEPS[-1], LOOP_STEPS[-1] / 2))
        if is_late:
            assert narrow == pytest.approx(speed * SAMPLE_TIME, rel=0.1)
        else:
            assert wide < 1e-5
            assert wide / narrow == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["libcosimpy", "OMSimulator"])
def test_others_take_the_step_from_the_file(tool: str, ssp_of: SspOf) -> None:
    """The annotations with the communication step are those that libcosim and OMSimulator read."""
    own = at_the_instant(tool, ssp_of("motion"), load_ssp(ssp_of("motion")).step)
    assert at_the_instant(tool, ssp_of("motion"), 0.0) == own
