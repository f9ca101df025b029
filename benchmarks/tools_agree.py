"""One run in our master, in fmpy and in the masters of other tools: their differences as a table.

    python benchmarks/tools_agree.py

It needs what the tests need: `pip install --group test`, and `.ci/tools` for Maestro. A tool that isn't there is left out.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest

sys.path.extend(str(Path(__file__).parents[1] / "tests" / each) for each in ("third_party", "cosim/exchange/ssp"))

from third_party_support.agreement import STOP, TOOLS, SharedRun, Table, Tool, apart, exact, shared_run

from flexfmu import load_scene

SCENE = "barnard2012-6kg"
STEPS = (1e-3, 5e-4, 2.5e-4)
"""Communication steps [s]."""

HEADINGS = ("tool", "records outputs", *(f"at {1e3 * step:g} ms" for step in STEPS), "order", "from", "differs by")
WIDTHS = (15, 16, 11, 11, 11, 7, 10, 10)


def rows(shared: SharedRun, each: Tool, references: list[Table], found: dict[str, list[Table]]) -> list[str]:
    """The cells of a tool's line."""
    found[each.name] = results = [each.simulate(shared, step) for step in STEPS]
    differences = [apart(*pair) for pair in zip(results, references, strict=True)]
    cells = [each.name, each.records, *(f"{difference:.2%}" for difference in differences)]
    order = f"{differences[-2] / differences[-1]:.2f}"
    if each.like not in found:
        return [*cells, order, "", ""]
    pairs = zip(results, found[each.like], strict=True)
    return [*cells, order, each.like, f"{max(apart(*pair) for pair in pairs):.0e}"]


def print_line(cells: list[str]) -> None:
    """One line of the table."""
    print("".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=True)).rstrip())


def main() -> None:
    """Run and print."""
    print(f"{SCENE}, {STOP} s; difference to our master with derivatives, relative to each signal's largest value")
    print_line([*HEADINGS])
    found: dict[str, list[Table]] = {}
    with tempfile.TemporaryDirectory() as folder:
        shared = shared_run(load_scene(SCENE), Path(folder))
        references = [exact(shared, step) for step in STEPS]
        for each in TOOLS:
            try:
                print_line(rows(shared, each, references, found))
            except pytest.skip.Exception as missing:
                print(f"{each.name}: left out, {missing}")


if __name__ == "__main__":
    main()
