"""Torque-driven loops in importers of other tools: the difference of the end effector's position to our master, as a table.

    python benchmarks/ssp_importers.py

The paper's robot, 6 kg, with motor inertia 0.1 kg m2 and controllers at 4 kHz, as SSP files: largest difference in x within the
first 0.2 s, for communication steps of a sample time, half and a quarter of it. It needs what the tests need:
`pip install --group test`. A tool that isn't there is left out.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "cosim" / "exchange" / "ssp"))

from ssp_support.loops import LOOPS, STEPS, Table, export_loop, in_our_master, off

TOOLS = ("libcosimpy", "ecospy", "fmpy")


def cell(tool: str, path: Path, step: float, exact: Table) -> str:
    """Largest difference to our master [mm]."""
    try:
        return f"{1e3 * off(tool, path, step, exact).max():.4f}"
    except Exception:  # each tool has its own for a run that ends early
        return "fails"


def main() -> None:
    """Run and print."""
    print("largest difference to our master within 0.2 s [mm], end-effector position x")
    print(f"{'loop':32}{'importer':12}" + "".join(f"{1e3 * step:g} ms".ljust(12) for step in STEPS))
    with tempfile.TemporaryDirectory() as folder:
        for name in LOOPS:
            path = export_loop(name, Path(folder))
            try:
                exact = in_our_master(path)
            except RuntimeError as error:
                print(f"{name:32}fails in our master: {error}")
                continue
            for tool in TOOLS:
                try:
                    cells = [cell(tool, path, step, exact) for step in STEPS]
                except pytest.skip.Exception as missing:
                    cells = [f"left out: {missing}"]
                print(f"{name:32}{tool:12}" + "".join(each.ljust(12) for each in cells))


if __name__ == "__main__":
    main()
