"""The cost of a run of the robot's FMU by its parts, and its floor: the generated functions alone.

The paper's motion of 0.43 s with a dwell of 0.25 s drives the FMU's own sources, compiled as FMUs are, by a
function in C (`fmu_cost.c`) through the FMI functions: no Python and no recording takes part. `floor` is what the calls of the
generated functions in that run cost by themselves, each timed in a loop: residuals, mass matrices and margins of the
integrator; for `whole` also the outputs and their two derivatives at every communication point.

    python benchmarks/fmu_cost.py [--step 1e-3] [--repeat 20] [--json]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from ctypes import CDLL, c_double, c_void_p
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from paper_scene import SCENES

from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.fmu_build.choices import INTEGRATOR
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.toolchain import find_compiler, native_platform
from flexfmu.model.plants import build_model
from flexfmu.model.scene.schema import Scene

CASES = (
    ("automatic", 1e-3),
    ("automatic", 1e-5),
    ("automatic", 1e-7),
    ("gauss4", 1e-5),
    ("gauss3", 1e-5),
    ("dopri5", 1e-5),
)

COUNTERS = ("steps", "rejections", "evaluations", "iterations", "factorisations")
FUNCTIONS = ("residual", "mass_matrix", "singularity", "outputs", "motion_rate1", "motion_rate2")
FIGURES = (*COUNTERS, "ends_in_stage", "integration", "with_outputs", "whole", *FUNCTIONS)
"""The results of `fmu_cost.c`."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="The cost of a run of the FMU.")
    parser.add_argument("--step", type=float, default=1e-3, help="communication step [s]")
    parser.add_argument("--repeat", type=int, default=20, help="runs of which the fastest counts")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="flexfmu-cost-") as folder:
        rows = [row for n in SCENES for row in measure(n, Path(folder), options.step, options.repeat)]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    print("    n  integrator  tolerance  evaluations  each      integration  floor    ratio    whole    floor    ratio")
    for row in rows:
        print(
            f"{row['coordinates']:>5} {row['integrator']:>11} {row['tolerance']:10.0e} {row['evaluations']:12.0f}"
            f" {1e9 * row['residual']:5.0f} ns {1e3 * row['integration']:10.2f} ms {1e3 * row['integration_floor']:5.2f} ms"
            f" {row['integration'] / row['integration_floor']:7.2f} {1e3 * row['whole']:6.2f} ms"
            f" {1e3 * row['whole_floor']:5.2f} ms {row['whole'] / row['whole_floor']:7.2f}"
        )


def measure(coordinates: int, folder: Path, step: float, repeat: int) -> list[dict[str, Any]]:
    """All cases of one scene."""
    table = folder / "inputs.bin"
    steps = write_inputs(SCENES[coordinates], step, table)
    library = build(SCENES[coordinates], folder)
    rows = []
    for integrator, tolerance in CASES:
        found = run(library, table, integrator, tolerance, repeat)
        case = {"coordinates": coordinates, "integrator": integrator, "tolerance": tolerance}
        rows.append({**case, **found, **floors(found, steps)})
    return rows


def run(library: CDLL, table: Path, integrator: str, tolerance: float, repeat: int) -> dict[str, float]:
    """The figures of `fmu_cost.c`."""
    figures = np.empty(len(FIGURES))
    number = INTEGRATOR.items[integrator][0]
    library.fmu_cost(str(table).encode(), c_double(tolerance), number, repeat, figures.ctypes.data_as(c_void_p))
    return dict(zip(FIGURES, figures.tolist(), strict=True))


def floors(found: Mapping[str, float], steps: int) -> dict[str, float]:
    """Times [s] of the generated functions alone: in the integration, with the outputs' values, and with their derivatives.

    A step that ends in a stage needs no mass matrix; first derivatives of outputs come with one, and with the outputs.
    """
    explicit, ends_in_stage = found["iterations"] == 0, found["ends_in_stage"] == 1.0
    masses = found["evaluations"] if explicit else 0.0 if ends_in_stage else found["steps"]
    integration = found["evaluations"] * found["residual"] + masses * found["mass_matrix"]
    integration += found["steps"] * found["singularity"]
    with_outputs = integration + steps * found["outputs"]
    whole = integration + steps * (found["motion_rate1"] + found["motion_rate2"])
    return {"integration_floor": integration, "with_outputs_floor": with_outputs, "whole_floor": whole}


def write_inputs(scene: Scene, step: float, path: Path) -> int:
    """The references of all communication steps with their derivatives, as `fmu_cost.c` reads them; how many there are."""
    motion = plan(scene)
    times = np.arange(round(motion.stop_time / step) + 1) * step
    slave = TrajectorySlave(motion.joints)
    slave.prepare(times)
    indices, rows = np.arange(len(slave.variables)), []
    for time in times[:-1]:
        slave.announce(float(time))
        values, derivatives = np.empty(indices.size), np.empty((slave.announced_order, indices.size))
        slave.get(indices, values)
        slave.get_derivatives(indices, derivatives)
        rows.append(np.concatenate([values, derivatives.ravel()]))
        slave.step(float(time), step)
    head = [step, len(rows), indices.size, slave.announced_order]
    np.concatenate([head, *rows]).astype(float).tofile(path)
    return len(rows)


def build(scene: Scene, folder: Path) -> CDLL:
    """The FMU's sources with `fmu_cost.c` among them, compiled with the FMU's flags."""
    sources = generate_sources(build_model(scene), DefaultExperiment())
    source = Path(__file__).with_name("fmu_cost.c")
    runtime = sources.runtime | {source.name: source.read_text(encoding="utf-8")}
    path = folder / f"cost{len(list(folder.iterdir()))}.so"
    path.write_bytes(compile_library(replace(sources, runtime=runtime), find_compiler(native_platform())))
    return CDLL(str(path))


if __name__ == "__main__":
    main()
