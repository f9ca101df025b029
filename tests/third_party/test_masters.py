"""Other people's masters run our FMUs as ours does.

They know nothing of input derivatives: motion and robot step side by side (Jacobi) with inputs held over the step, which is
of order 1. Given the same rule, our master has the same numbers; and as the step becomes smaller, all tend to what ours finds
with derivatives. libcosim and Maestro record what the robot puts out before it gets its new inputs, ecos and ours after.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from third_party_support import maestro, masters
from third_party_support.tools import python_tool, run

from flexfmu.cosim.algorithms import Algorithm, GaussSeidel, Jacobi
from flexfmu.cosim.fmu_slave import FmuSlave
from flexfmu.cosim.master import simulate
from flexfmu.cosim.slave_export import export_slaves
from flexfmu.cosim.system import connect
from flexfmu.model.scene_file import load_scene

pytestmark = pytest.mark.slow

STOP = 0.1
"""The robot has accelerated for a quarter of the motion."""

STEPS = (1e-3, 5e-4)
ROUNDING = 1e-9
"""Difference of the same sums in another order, relative to a signal's largest value, after a hundred steps."""

MODULES = {"libcosim": "libcosimpy", "ecos": "ecospy"}

Table = NDArray[np.float64]


@pytest.fixture(scope="session")
def system(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """FMUs of the paper's motion and robot, and how they are connected."""
    exported = export_slaves(load_scene("barnard2012-6kg"), tmp_path_factory.mktemp("slaves"))
    fmus = {slave.name: str(slave.path) for slave in exported.slaves}
    return {"fmus": fmus, "connections": [list(pair) for pair in exported.connections]}


def ours(system: dict[str, Any], step: float, algorithm: Algorithm, input_order: int | None) -> Table:
    """Signals at the communication points after the first, shape (points, signals)."""
    slaves = [FmuSlave(path, name, input_order=input_order) for name, path in system["fmus"].items()]
    wired = connect(slaves, [tuple(pair) for pair in system["connections"]])
    recording = simulate(wired, stop=STOP, step=step, algorithm=algorithm).recording
    return np.column_stack([recording[f"plant.{name}"].values[1:] for name in masters.SIGNALS])


def theirs(master: str, system: dict[str, Any], step: float, folder: Path) -> Table:
    """The same by another master, run in a process of its own."""
    python_tool(MODULES[master])
    file = folder / "system.json"
    file.write_text(json.dumps(system))
    output = run([sys.executable, masters.__file__, master, str(file), str(step), str(STOP)], folder)
    line = next(line for line in output.splitlines() if line.startswith("rows: "))
    return np.array(json.loads(line.removeprefix("rows: ")))[:, 1:]


def apart(first: Table, second: Table) -> float:
    """Largest difference, each signal relative to its largest value."""
    return float((np.abs(first - second).max(axis=0) / np.abs(second).max(axis=0)).max())


def test_ecos_has_the_numbers_of_our_master(system: dict[str, Any], tmp_path: Path) -> None:
    """The same rule gives the same numbers, at every communication point."""
    same_rule = ours(system, STEPS[0], Jacobi(), 0)
    assert apart(theirs("ecos", system, STEPS[0], tmp_path), same_rule) < ROUNDING


@pytest.mark.parametrize("master", MODULES)
def test_half_the_step_halves_the_difference(master: str, system: dict[str, Any], tmp_path: Path) -> None:
    """Held inputs are late by up to a step, so what other masters find tends to our result with order 1."""
    differences = []
    for step in STEPS:
        exact = ours(system, step, GaussSeidel(), None)
        differences.append(apart(theirs(master, system, step, tmp_path), exact))
    assert differences[0] / differences[1] == pytest.approx(2.0, rel=0.1)


def test_maestro_has_the_numbers_of_libcosim(system: dict[str, Any], tmp_path: Path) -> None:
    """Two masters of other people, written in other languages, agree on our FMUs."""
    found = maestro.simulate(system, STEPS[0], STOP, tmp_path)[1:]
    expected = theirs("libcosim", system, STEPS[0], tmp_path)[: len(found)]
    assert len(found) >= round(STOP / STEPS[0]) - 1
    assert apart(found[:, 1:], expected) < ROUNDING
