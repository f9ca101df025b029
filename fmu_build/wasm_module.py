"""A WebAssembly module as a folder for npm: the FMU's own C, unchanged, with its variables and a small interface in JavaScript."""

from __future__ import annotations

import io
import json
import re
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from lxml import etree

from flexfmu.fmu_build.archive import write_atomically
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.toolchain import WASM


def module_files(fmu: bytes) -> dict[str, bytes]:
    """File → content of the folder: the module, its interface with types, ``package.json``, README and licence.

    Args:
        fmu: an FMU 2.0 of this package with a binary for ``wasm32``.
    """
    with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
        identifier = root.find("CoSimulation").get("modelIdentifier")
        binary = archive.read(f"binaries/{WASM.name}/{identifier}{WASM.suffix}")
        licence = archive.read("documentation/licenses/license.txt")
    model = model_facts(root)
    variables = model["variables"]
    name, parameters = model["name"], [n for n, each in variables.items() if each["causality"] == "parameter"]
    package = re.sub(r"[^a-z0-9.-]+", "-", name.lower()).strip("-.")
    outputs = [n for n, each in variables.items() if each["causality"] == "output" and each["type"] == "Real"]
    first = next((n for n in parameters if variables[n]["type"] == "Real"), None)
    facts: dict[str, Any] = {
        "name": name,
        "text": root.get("description"),
        "package": package,
        "identifier": identifier,
        "variables": list(variables),
        "model": json.dumps(model, indent=1),
        "outputs": outputs[:2],
        "parameter": first and {"name": first, "start": variables[first]["start"]},
        "bytes": len(binary),
    }
    manifest = {
        "name": package,
        "version": "1.0.0",
        "description": root.get("description"),
        "type": "module",
        "main": "index.js",
        "types": "index.d.ts",
        "sideEffects": False,
        "license": "SEE LICENSE IN LICENSE",
        "files": [f"{identifier}{WASM.suffix}", "fmu.js", "index.js", "index.d.ts"],
    }
    texts = {
        "package.json": json.dumps(manifest, indent=2) + "\n",
        "index.js": render("index.js.j2", **facts),
        "index.d.ts": render("index.d.ts.j2", **facts),
        "README.md": render("module.md.j2", **facts),
        "fmu.js": interface(),
    }
    return {f"{identifier}{WASM.suffix}": binary, "LICENSE": licence} | {n: t.encode() for n, t in texts.items()}


def model_facts(root: Any) -> dict[str, Any]:
    """What JavaScript knows of a model: name, GUID, default experiment and variables.

    Args:
        root: the element ``fmiModelDescription``.
    """
    experiment, variables = root.find("DefaultExperiment"), {}
    for each in root.iterfind("ModelVariables/ScalarVariable"):
        kind = next(child for child in each if child.tag in ("Real", "Integer", "Boolean", "Enumeration", "String"))
        start = kind.get("start")
        shown = {
            "reference": int(each.get("valueReference")),
            "type": "Integer" if kind.tag == "Enumeration" else kind.tag,
            "causality": each.get("causality", "local"),
            "variability": each.get("variability", "continuous"),
            "unit": kind.get("unit"),
            "start": None if start is None else json.loads(start),
            "description": each.get("description"),
        }
        variables[each.get("name")] = {name: value for name, value in shown.items() if value is not None}
    step = experiment.get("stepSize")
    return {
        "name": root.get("modelName"),
        "guid": root.get("guid"),
        "step": float(step),
        "stopTime": float(experiment.get("stopTime")),
        "tolerance": float(experiment.get("tolerance", 1e-6)),
        "variables": variables,
    }


def interface() -> str:
    """The text of ``fmu.js``, the same for all modules."""
    return (files("flexfmu.fmu_build") / "templates" / "fmu.js").read_text(encoding="utf-8")


def write_module(fmu: bytes, folder: Path) -> None:
    """Write the folder of a module.

    Raises:
        ArchiveError: a file can't be written.
    """
    for name, content in module_files(fmu).items():
        write_atomically(folder / name, content)
