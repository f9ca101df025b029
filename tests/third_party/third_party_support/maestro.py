"""The INTO-CPS master Maestro 3.1.1 runs exported FMUs.

Their descriptions are changed for it in two respects, since it stops at both: it knows no parameters of type Enumeration
("Enumeration not supported", Initializer.setParameterOnPort), and it fails where an output is connected that is also the
declared derivative of another connected output (ClassCastException, ComponentVariableFmi2Api.share).
"""

from __future__ import annotations

import csv
import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from third_party_support.masters import SIGNALS
from third_party_support.tools import class_path, run

COARSE = "setupExperiment(true, 0.1,"
"""How Maestro calls fmi2SetupExperiment: with a relative tolerance of 0.1 that no configuration changes (0.5 % of a torque)."""

TOLERANCE = "1.0E-6"
"""Relative tolerance instead, that of the FMUs' default experiment."""


def simulate(system: Mapping[str, Any], step: float, stop: float, folder: Path) -> NDArray[np.float64]:
    """Time and `SIGNALS` at every communication point from 0 on, shape (points, 1 + signals)."""
    jars = class_path("maestro")
    fmus = {f"{{{name}}}": str(_adapted(Path(path), folder)) for name, path in system["fmus"].items()}
    connections: dict[str, list[str]] = {}
    for source, target in system["connections"]:
        connections.setdefault(_port(source), []).append(_port(target))
    model = {
        "fmus": fmus,
        "connections": connections,
        "parameters": {},
        "logVariables": {"{plant}.plant1": list(SIGNALS)},
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
    columns = ["time", *(f"{{plant}}.plant1.{name}" for name in SIGNALS)]
    return np.array([[float(row[column]) for column in columns] for row in rows])


def _port(name: str) -> str:
    slave, variable = name.split(".", 1)
    return f"{{{slave}}}.{slave}1.{variable}"


def _adapted(path: Path, folder: Path) -> Path:
    """A copy whose description Maestro can read: Integers for Enumerations, no declared derivatives of outputs."""
    target = folder / path.name
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as copy:
        for entry in source.infolist():
            content = source.read(entry)
            if entry.filename == "modelDescription.xml":
                text = re.sub(r'<Enumeration declaredType="[^"]*"', "<Integer", content.decode())
                content = re.sub(r' derivative="\d+"', "", text).encode()
            copy.writestr(entry, content)
    return target
