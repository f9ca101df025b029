"""The INTO-CPS master Maestro 3.1.1 runs exported FMUs, as they are; of its own program one number is changed, `COARSE`."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from third_party_support.tools import class_path, run

COARSE = "setupExperiment(true, 0.1,"
"""How Maestro calls fmi2SetupExperiment: with a relative tolerance of 0.1 that no configuration changes (0.5 % of a torque)."""

TOLERANCE = "1.0E-6"
"""Relative tolerance instead, that of the FMUs' default experiment."""


def simulate(system: Mapping[str, Any], step: float, stop: float, folder: Path) -> NDArray[np.float64]:
    """Time and the signals at every communication point from 0 on, shape (points, 1 + signals).

    Args:
        system: as `SharedRun` has it.
        step, stop: communication step and end [s].
        folder: for the files of the tool.
    """
    jars = class_path("maestro")
    fmus = {f"{{{name}}}": path for name, path in system["fmus"].items()}
    connections: dict[str, list[str]] = {}
    for source, target in system["connections"]:
        connections.setdefault(_port(source), []).append(_port(target))
    logged: dict[str, list[str]] = {}
    for signal in system["signals"]:
        slave, variable = signal.split(".", 1)
        logged.setdefault(f"{{{slave}}}.{slave}1", []).append(variable)
    model = {
        "fmus": fmus,
        "connections": connections,
        "parameters": {},
        "logVariables": logged,
        "algorithm": {"type": "fixed-step", "size": step},
        "startTime": 0.0,
        "endTime": stop,
    }
    (folder / "model.json").write_text(json.dumps(model))
    start = ["java", "-XX:TieredStopAtLevel=1", "-cp", jars, "org.intocps.maestro.Main"]
    run([*start, "import", "sg1", "-output", ".", "model.json"], folder)
    specification = folder / "spec.mabl"
    text = specification.read_text()
    assert text.count(COARSE) == len(fmus)
    specification.write_text(text.replace(COARSE, f"setupExperiment(true, {TOLERANCE},"))
    run([*start, "interpret", "-runtime", "spec.runtime.json", "spec.mabl"], folder)
    with (folder / "outputs.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    columns = ["time", *map(_port, system["signals"])]
    return np.array([[float(row[column]) for column in columns] for row in rows])


def _port(name: str) -> str:
    slave, variable = name.split(".", 1)
    return f"{{{slave}}}.{slave}1.{variable}"
