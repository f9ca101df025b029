"""What a build with an empty cache takes, for robots of more and more coordinates: processor and clock time of `flexfmu build`.

Families: proximal links bend and distal ones stretch, every link does both, and a chain of reactions from equations, whose states
hang together sparsely. The compiler takes most of it. Another clone, whose environment is in its folder `.venv`, is measured in the
same run, in turn.

    python benchmarks/build_times.py [--repeat 1] [--coordinates 12 16 48 72] [--states 40 200] [--beside FOLDER]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from flexfmu.fmu_build.cache import FOLDER_VARIABLE

FAMILIES = {
    "proximal links bend, distal ones stretch": ("proximal_bending", "distal_axial"),
    "every link does both": ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial"),
}
"""Name of a family → effects with equally many modes on each of two legs."""

MODEL = """import flexfmu

def rhs(x, p):
    values = [1.0, *x, 0.0]
    return [p.d * (a - 2 * b + c) - b**2 * (1 + c) for a, b, c in zip(values, values[1:], values[2:])]

model = flexfmu.ode("chain", x={f"x[{k}]": 1.0 for k in range(1, N + 1)}, p={"d": 1.0}, rhs=rhs)
"""
"""A chain of N reactions."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Builds with an empty cache.")
    parser.add_argument("--repeat", type=int, default=1, help="builds of which the fastest counts")
    parser.add_argument("--coordinates", type=int, nargs="*", default=[12, 16, 48, 72])
    parser.add_argument("--states", type=int, nargs="*", default=[40, 200])
    parser.add_argument("--beside", type=Path, help="folder of another clone")
    options = parser.parse_args()
    pythons = [sys.executable, *([str(options.beside / ".venv/bin/python")] if options.beside else [])]
    # what is built: number of unknowns, family, arguments of the command
    builds = []
    for family, effects in FAMILIES.items():
        for coordinates in options.coordinates:
            modes, rest = divmod(coordinates, 2 * len(effects))
            if not rest:
                builds.append(
                    (coordinates, family, ["barnard2012-6kg", *(f"--set=effects.{e}={modes}" for e in effects)])
                )
    builds += [(states, "chain of reactions", ["model.py:model"]) for states in options.states]
    print("   unknowns  processor      clock  family")
    for unknowns, family, arguments in builds:
        found = [(float("inf"), float("inf"))] * len(pythons)
        for _ in range(options.repeat):
            times = [build_time(python, arguments, unknowns) for python in pythons]
            found = [min(pair) for pair in zip(found, times, strict=True)]
        for python, (processor, clock) in zip(pythons, found, strict=True):
            where = "" if python == sys.executable else f", {options.beside}"
            print(f"{unknowns:11} {processor:8.2f} s {clock:8.2f} s  {family}{where}", flush=True)


def build_time(python: str, arguments: list[str], unknowns: int) -> tuple[float, float]:
    """Processor time [s] of a build and of the compilers that it starts, and its time by the clock [s]."""
    with tempfile.TemporaryDirectory(prefix="flexfmu-build-") as name:
        variables = os.environ | {
            FOLDER_VARIABLE: f"{name}/cache",
            "PYTHONPYCACHEPREFIX": tempfile.gettempdir() + "/flexfmu-bytecode",
        }
        variables.pop("PYTHONDONTWRITEBYTECODE", None)
        command = [python, "-m", "flexfmu", "build", *arguments, f"--output={name}/built.fmu"]
        Path(name, "model.py").write_text(MODEL.replace("N +", f"{unknowns} +"), encoding="utf-8")
        before, started = os.times(), perf_counter()
        subprocess.run(command, cwd=name, env=variables, check=True, capture_output=True)
        after = os.times()
        return sum(after[2:4]) - sum(before[2:4]), perf_counter() - started


if __name__ == "__main__":
    main()
