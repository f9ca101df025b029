"""Other people's importers run an exported scene and agree with our master to first order in the step."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy.ssp.simulation
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssv

from flexfmu.cosim.ssp.export import PARAMETERS
from flexfmu.cosim.ssp.loading import load_ssp

STEPS = (4e-4, 2e-4)
INSTANT = 0.2
"""In the middle of the motion [s]."""

SIGNAL = "end_effector.position.x"
SCRIPT = Path(__file__).parent / "ssp_support" / "importer.py"


@pytest.fixture(scope="session")
def reference(motion_ssp: Path) -> float:
    """Position at the instant, by our master with derivatives of all orders."""
    recording = load_ssp(motion_ssp, stop=INSTANT).simulate().recording
    return float(recording[f"plant.{SIGNAL}"].values[-1])


def check_order(errors: tuple[float, float]) -> None:
    """Halving the step halves the error, which is that of references that are one or two steps old."""
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)
    assert errors[1] < 1e-3


@contextmanager
def started_from_outputs() -> Iterator[None]:
    """Let fmpy begin with what the FMUs put out: by itself it feeds zeros to every input in the first step."""
    simulation = fmpy.ssp.simulation
    components: list[Any] = []
    connections: list[Any] = []
    instantiate, connect = simulation.instantiate_fmu, simulation.get_connections

    def connecting(system: Any) -> Any:
        connections[:] = connect(system)
        return list(connections)

    def starting(component: Any, *arguments: Any) -> None:
        instantiate(component, *arguments)
        components.append(component)
        for connector in component.connectors:
            if connector.kind == "output":
                connector.value = simulation.get_value(component, connector.name)
        for source, target in connections:
            target.value = source.value

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "instantiate_fmu", starting)
        patch.setattr(simulation, "get_connections", connecting)
        yield


def in_fmpy(path: Path, step: float) -> float:
    """The position at the instant."""
    values = read_ssv(path, resource=PARAMETERS)
    result = fmpy.ssp.simulation.simulate_ssp(path, stop_time=INSTANT - step / 2, step_size=step, parameter_set=values)
    assert result["time"][-1] + step == pytest.approx(INSTANT)
    return float(result[f"plant.{SIGNAL}"][-1])


def in_process(tool: str) -> Callable[[Path, float], float]:
    """A function that runs a file in another tool, in a process of its own."""

    def run(path: Path, step: float) -> float:
        libraries = os.pathsep.join([str(Path(sys.prefix) / "lib"), os.environ.get("LD_LIBRARY_PATH", "")])
        outcome = subprocess.run(
            [sys.executable, str(SCRIPT), tool, str(path), str(step), str(INSTANT), SIGNAL],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
            env={**os.environ, "LD_LIBRARY_PATH": libraries},
        )
        if outcome.returncode == 77:
            pytest.skip(f"{tool} is not installed: {outcome.stderr.strip()}")
        assert outcome.returncode == 0, outcome.stdout + outcome.stderr
        result = next(line for line in outcome.stdout.splitlines() if line.startswith("{"))
        return float(json.loads(result)["value"])

    return run


def test_fmpy(motion_ssp: Path, reference: float) -> None:
    """fmpy's own SSP simulation, started from the FMUs' outputs."""
    with started_from_outputs():
        errors = tuple(abs(in_fmpy(motion_ssp, step) - reference) for step in STEPS)
    check_order((errors[0], errors[1]))


def test_fmpy_as_it_is(motion_ssp: Path) -> None:
    """The first step with zeros at all inputs kicks the robot; it still arrives."""
    result = fmpy.ssp.simulation.simulate_ssp(motion_ssp, stop_time=0.43, step_size=STEPS[0])
    assert np.isfinite(result[f"plant.{SIGNAL}"]).all()
    assert result[f"plant.{SIGNAL}"][-1] == pytest.approx(0.175, abs=1e-3)


@pytest.mark.parametrize("tool", ["libcosimpy", "ecospy", "OMSimulator"])
def test_other_importers(tool: str, motion_ssp: Path, reference: float) -> None:
    """libcosim, ecos and OMSimulator read the file as it is."""
    run = in_process(tool)
    errors = [abs(run(motion_ssp, step) - reference) for step in STEPS]
    check_order((errors[0], errors[1]))


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["libcosimpy", "ecospy"])
def test_controllers_in_other_importers(tool: str, controlled_ssp: Path) -> None:
    """Controllers, shaper, encoder and amplifier too, though each passes signals on a step late."""
    run = in_process(tool)
    recording = load_ssp(controlled_ssp, stop=INSTANT).simulate().recording
    expected = float(recording[f"plant.{SIGNAL}"].values[-1])
    errors = [abs(run(controlled_ssp, step) - expected) for step in (1e-4, 5e-5)]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)


def test_libcosim_takes_the_step_from_the_file(motion_ssp: Path) -> None:
    """The annotation with the communication step is the one that libcosim reads."""
    run = in_process("libcosimpy")
    assert run(motion_ssp, 0.0) == run(motion_ssp, load_ssp(motion_ssp).step)
