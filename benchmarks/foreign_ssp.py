"""SSP files of other tools in our master, and in the tools that can run them here, as a Markdown table.

    python benchmarks/foreign_ssp.py [--refine N] [--read-again] [--add-times] FILE.ssp FOLDER/SystemStructure.ssd ...

An unpacked description is packed with the files that it names. The first 100 communication steps are run, of 1 ms
where the file names none, or the same time in N times as many steps. *Runs* is the result of `flexfmu run`. For the other columns our master is set to hold inputs and
to couple all slaves side by side, as those tools do; the figure is the largest difference of any real output at a quarter, half,
three quarters and the end of the run, relative to that output's largest value. The column *itself* is what a relative tolerance
that is 1 % smaller changes in our own master: no tool can agree better. It needs what the tests need:
`pip install --group test`; OMSimulator, libcosim and ecos are left out where they can't be imported.

With `--read-again` our master reads all outputs of an FMU once more whenever it has set inputs, with `--add-times` it adds up times as
OMSimulator does. By the standard that changes nothing, or the last bit.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "cosim" / "exchange" / "ssp"))

from ssp_support.importers import signals_in

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.couplings import Jacobi
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import Call, Indices, RealArray
from flexfmu.cosim.exchange.ssp.archive import DESCRIPTION
from flexfmu.cosim.exchange.ssp.loading import SspSystem, load_ssp
from flexfmu.cosim.exchange.ssp.structure import levels

TOOLS = {"OMSimulator": "OMSimulator", "libcosim": "libcosimpy", "ecos": "ecospy"}
COUNT = 100
"""Communication steps."""

STEP, STOP = 1e-3, 1.0
"""Where a file names none [s]."""

TOLERANCE = 1e-4
"""What OMSimulator tells FMUs where a file names none."""


def read_again() -> None:
    """Let FMUs be read after each setting of inputs."""
    bind_set = FmuSlave.bind_set

    def bind(slave: FmuSlave, indices: Indices, values: RealArray) -> Call:
        outputs = [i for i, each in enumerate(slave.variables) if each.causality == "output" and not each.text]
        write = bind_set(slave, indices, values)
        read = slave.bind_get(np.array(outputs, dtype=np.intp), np.empty(len(outputs)))

        def both() -> None:
            write()
            read()

        return both

    FmuSlave.bind_set = bind


def add_times() -> None:
    """Let FMUs be stepped at times that are added up."""
    initialize, step = FmuSlave.initialize, FmuSlave.step
    reached: dict[str, float] = {}

    def begin(slave: FmuSlave, start_time: float, stop_time: float, tolerance: float | None) -> None:
        reached[slave.name] = start_time
        initialize(slave, start_time, stop_time, tolerance)

    def advance(slave: FmuSlave, time: float, length: float) -> None:
        at = reached[slave.name]
        length = float(f"{length:.12g}")  # without the rounding of the difference of two times
        step(slave, at, length)
        reached[slave.name] = at + length

    FmuSlave.initialize, FmuSlave.step = begin, advance
    FmuSlave.bound_step = lambda slave: None


@dataclass(frozen=True)
class Package:
    """An SSP file with the description that is meant.

    Attributes:
        path: the file.
        ssd: path of the description within it.
        name, origin: how the table calls it, and where it is from.
        refine: how many communication steps stand for one.
    """

    path: Path
    ssd: str
    name: str
    origin: str
    refine: int = 1


def packed(path: Path, folder: Path, number: int, refine: int = 1) -> Package:
    """The file, or a description packed with what its sources name."""
    owner = next((part.replace("+", "/") for part in path.parts if "+" in part), "")
    name = "/".join(path.parts[-2:])
    if path.suffix == ".ssp":
        return Package(path, DESCRIPTION, name, owner, refine)
    sources = re.findall(r'source\s*=\s*"([^":?]+)"', path.read_text(encoding="utf-8", errors="replace"))
    files = [each for each in ((path.parent / source).resolve() for source in sources) if each.is_file()]
    root = Path(os.path.commonpath([path.parent.resolve(), *(each.parent for each in files)]))
    ssd = (path.parent.resolve() / DESCRIPTION).relative_to(root).as_posix()
    target = folder / str(number) / f"{path.parent.name}.ssp"
    target.parent.mkdir()
    with zipfile.ZipFile(target, "w") as archive:
        archive.write(path, ssd)
        for each in dict.fromkeys(files):
            archive.write(each, each.relative_to(root).as_posix())
    return Package(target, ssd, name, owner, refine)


def loaded(package: Package, **options: int) -> SspSystem:
    """The system, for the first steps."""
    times: dict[str, float] = {}
    while True:
        try:
            found = load_ssp(package.path, ssd=package.ssd, **times, **options)
        except CosimError as error:
            missing = next((key for key in ("step", "stop") if f"names no {key} time" in str(error)), None)
            if missing is None:
                raise
            times[missing] = {"step": STEP, "stop": STOP}[missing]
        else:
            times = {"step": found.step / package.refine, "stop": found.start + COUNT * found.step}
            return load_ssp(package.path, ssd=package.ssd, **times, **options)


def compared(package: Package) -> list[str]:
    """The columns of the other tools."""
    system = loaded(package, output_order=0)
    signals = [
        (prefix + component.name, each.name)
        for prefix, level in levels(system.structure)
        for component in level.components
        for each in component.connectors
        if each.kind == "output" and each.type == "Real"
    ]
    tolerance = system.tolerance or TOLERANCE
    recording, again = (
        system.simulate(algorithm=Jacobi(), tolerance=t).recording for t in (tolerance, 0.99 * tolerance)
    )
    signals = [each for each in signals if ".".join(each) in recording.columns]
    ours = [recording[".".join(each)].values for each in signals]
    scale = np.array([max(abs(values).max(), 1e-9) for values in ours])
    quarters = [(system.stop - system.start) * k / 4 for k in range(1, 5)]

    # what an instant ends at: after a jump there, where a tool reads outputs that have got their new inputs
    def at_quarters(results: Recording) -> np.ndarray:
        last = [np.searchsorted(results.time, t * (1 + 1e-9)) - 1 for t in quarters]
        return np.array([[results[".".join(each)].values[i] for each in signals] for i in last])

    expected = at_quarters(recording)
    cells = []
    for tool in ["", *TOOLS.values()]:
        found = theirs(tool, package, system.step, quarters, signals) if tool else at_quarters(again)
        cells.append("-" if found is None or not signals else f"{(abs(found - expected) / scale).max():.0e}")
    return [each.replace("0e+00", "0") for each in cells]


def theirs(
    tool: str, package: Package, step: float, instants: list[float], signals: list[tuple[str, str]]
) -> np.ndarray | None:
    """Outputs in another tool, with our step or with its own; None where it doesn't run the file or isn't there."""
    for each in (step, 0.0):
        try:
            return signals_in(tool, package.path, each, instants, signals)
        except (AssertionError, pytest.skip.Exception, subprocess.TimeoutExpired):
            continue
    return None


def row(package: Package) -> list[str]:
    """The cells of a file."""
    others = ["-"] * (1 + len(TOOLS))
    try:
        system = loaded(package)
        simulation = system.simulate()
    except CosimError as error:
        return [package.name, package.origin, "no: " + shortened(str(error), package), *others]
    if simulation.outcome is not Outcome.COMPLETED:
        return [package.name, package.origin, "no: " + shortened(simulation.message, package), *others]
    return [
        package.name,
        package.origin,
        f"yes, {len(system.names)} FMU{'s'[: len(system.names) - 1]}",
        *compared(package),
    ]


def shortened(text: str, package: Package) -> str:
    """An error without the file's name, which is in the first column."""
    text = re.sub(
        rf"^({re.escape(str(package.path))}|{re.escape(package.path.name)}, [^,]*\.ss., line \d+): ", "", text
    )
    text = text.replace(str(package.path), package.path.name).replace("|", "\\|").replace("<", "`<").replace(">", ">`")
    return text if len(text) < 160 else text[:157] + "..."


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--read-again", action="store_true")
    parser.add_argument("--add-times", action="store_true")
    chosen = parser.parse_args()
    if chosen.read_again:
        read_again()
    if chosen.add_times:
        add_times()
    print("| File | From | Runs | itself | " + " | ".join(TOOLS) + " |")
    print("|---|---|---|---|" + "---|" * len(TOOLS))
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate(chosen.files):
            package = packed(path.absolute(), Path(folder), number, chosen.refine)
            print("| " + " | ".join(row(package)) + " |", flush=True)


if __name__ == "__main__":
    main()
