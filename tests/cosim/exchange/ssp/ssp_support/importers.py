"""Signals of an SSP file as other people's importers find them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy.ssp.simulation
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssv
from numpy.typing import NDArray

from flexfmu.cosim.exchange.ssp.export import PARAMETERS

SIGNAL = "end_effector.position.x"
SCRIPT = Path(__file__).parent / "importer.py"


def simulate(tool: str, path: Path, step: float, instants: Sequence[float]) -> NDArray[np.float64]:
    """The signal at the instants [s], multiples of the step, in ``fmpy`` or another tool, which has a process of its own.

    Skips the test where the tool isn't installed; that it fails is an AssertionError.
    """
    if tool == "fmpy":
        return _in_fmpy(path, step, instants)
    return signals_in(tool, path, step, instants, [("plant", SIGNAL)])[:, 0]


def signals_in(
    tool: str,
    path: Path,
    step: float,
    instants: Sequence[float],
    signals: Sequence[tuple[str, str]],
    limit: float = 600,
) -> NDArray[np.float64]:
    """Signals (element, variable) at the instants, in a tool that has a process of its own: (instants, signals).

    Skips the test where the tool isn't installed; that it fails is an AssertionError; longer than the limit [s] is a TimeoutExpired.
    """
    libraries = os.pathsep.join([str(Path(sys.prefix) / "lib"), os.environ.get("LD_LIBRARY_PATH", "")])
    outcome = subprocess.run(
        [sys.executable, str(SCRIPT), tool, str(path), str(step), json.dumps([*instants]), json.dumps([*signals])],
        capture_output=True,
        text=True,
        timeout=limit,
        check=False,
        env={**os.environ, "LD_LIBRARY_PATH": libraries},
    )
    if outcome.returncode == 77:
        pytest.skip(f"{tool} is not installed: {outcome.stderr.strip()}")
    assert outcome.returncode == 0, (outcome.stdout + outcome.stderr)[-3000:]
    result = next(line for line in outcome.stdout.splitlines() if line.startswith("{"))
    return np.array(json.loads(result)["values"])


def _in_fmpy(path: Path, step: float, instants: Sequence[float]) -> NDArray[np.float64]:
    values = read_ssv(path, resource=PARAMETERS)
    with started_from_outputs():
        simulate_ssp = fmpy.ssp.simulation.simulate_ssp
        result = simulate_ssp(path, stop_time=instants[-1] - step / 2, step_size=step, parameter_set=values)
    assert result["time"][-1] + step == pytest.approx(instants[-1])
    return np.array([result[f"plant.{SIGNAL}"][round(instant / step) - 1] for instant in instants])


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
