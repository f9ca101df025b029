"""What a run of the robot's FMU costs and where the time goes, with the floor beside it: the generated functions alone.

The paper's motion of 0.43 s with a dwell of 0.25 s is played to the FMU's own sources, compiled as FMUs are, by a small
program in C (`fmu_cost.c`) through the FMI functions: no Python and no recording takes part. `floor` is what the calls of the
generated functions in that run cost by themselves, each timed in a loop: residuals, mass matrices and margins of the
integrator; for `whole` also the outputs and their two derivatives at every communication point.

    python benchmarks/fmu_cost.py [--step 1e-3] [--repeat 20] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from paper_scene import SCENE

from flexfmu.cosim.planning import plan
from flexfmu.cosim.trajectory_slave import TrajectorySlave
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.integrators import INTEGRATOR
from flexfmu.fmu_build.platforms import native_platform
from flexfmu.fmu_build.sources import generate_sources
from flexfmu.fmu_build.toolchain import COMMON_FLAGS, GENERATED_FLAGS, RUNTIME_FLAGS, Compiler, find_compiler
from flexfmu.model.plants import build_model
from flexfmu.model.scene import Scene

SCENES = {"12": SCENE, "6": SCENE.replace({"effects.proximal_bending": 2, "effects.distal_axial": 1})}
"""Degrees of freedom → scene."""
CASES = (
    ("automatic", 1e-3),
    ("automatic", 1e-5),
    ("automatic", 1e-7),
    ("gauss4", 1e-5),
    ("radau3", 1e-5),
    ("dopri5", 1e-5),
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What a run of the FMU costs.")
    parser.add_argument("--step", type=float, default=1e-3, help="communication step [s]")
    parser.add_argument("--repeat", type=int, default=20, help="runs of which the fastest counts")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="flexfmu-cost-") as folder:
        rows = [row for name in SCENES for row in measure(name, Path(folder), options.step, options.repeat)]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    print("    n  integrator  tolerance  evaluations  each      integration  floor    ratio    whole    floor    ratio")
    for row in rows:
        print(
            f"{row['coordinates']:>5} {row['integrator']:>11} {row['tolerance']:10.0e} {row['evaluations']:12d}"
            f" {1e9 * row['residual']:5.0f} ns {1e3 * row['integration']:10.2f} ms {1e3 * row['integration_floor']:5.2f} ms"
            f" {row['integration'] / row['integration_floor']:7.2f} {1e3 * row['whole']:6.2f} ms"
            f" {1e3 * row['whole_floor']:5.2f} ms {row['whole'] / row['whole_floor']:7.2f}"
        )


def measure(name: str, folder: Path, step: float, repeat: int) -> list[dict[str, Any]]:
    """All cases of one scene."""
    table = folder / "inputs.bin"
    steps = write_inputs(SCENES[name], step, table)
    program = build(SCENES[name], folder / name)
    rows = []
    for integrator, tolerance in CASES:
        arguments = [str(program), str(table), repr(tolerance), str(INTEGRATOR.items[integrator][0]), str(repeat)]
        found = json.loads(subprocess.run(arguments, check=True, capture_output=True, text=True).stdout)
        rows.append(
            {"coordinates": name, "integrator": integrator, "tolerance": tolerance, **found, **floors(found, steps)}
        )
    return rows


def floors(found: Mapping[str, float], steps: int) -> dict[str, float]:
    """Times [s] of the generated functions alone: in the integration, and in the whole run."""
    explicit = found["iterations"] == 0
    masses = found["evaluations"] if explicit else found["steps"]
    integration = found["evaluations"] * found["residual"] + masses * found["mass_matrix"]
    integration += found["steps"] * found["singularity"]
    shown = ("outputs", "residual_forward", "outputs_forward", "residual_rate2", "outputs_rate2")
    return {"integration_floor": integration, "whole_floor": integration + steps * sum(found[each] for each in shown)}


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


def build(scene: Scene, folder: Path) -> Path:
    """The measuring program with the FMU's sources in it, compiled with the FMU's flags."""
    folder.mkdir()
    compiler = find_compiler(native_platform())
    sources = generate_sources(build_model(scene), DefaultExperiment())
    flags = dict.fromkeys(sources.generated, GENERATED_FLAGS) | dict.fromkeys(sources.runtime, RUNTIME_FLAGS)
    for name, text in (sources.generated | sources.runtime).items():
        (folder / name).write_text(text, encoding="utf-8")
    main_file = Path(__file__).with_name("fmu_cost.c")
    (folder / main_file.name).write_bytes(main_file.read_bytes())
    flags[main_file.name] = RUNTIME_FLAGS
    names = [name for name in flags if name.endswith(".c")]
    for name in names:
        compile_one(compiler, name, flags[name], folder)
    objects = [f"{Path(name).stem}.o" for name in names]
    subprocess.run([*compiler.command, *objects, "-o", "fmu_cost", "-lm"], cwd=folder, check=True)
    return folder / "fmu_cost"


def compile_one(compiler: Compiler, name: str, flags: tuple[str, ...], folder: Path) -> None:
    """One object file."""
    command = [*compiler.command, *COMMON_FLAGS, *compiler.platform.compile_flags, *flags, "-c", name]
    subprocess.run(command, cwd=folder, check=True, env=os.environ | {"LC_ALL": "C"})


if __name__ == "__main__":
    main()
