"""FMUs of other tools in our master and in fmpy: same step, same start values, same inputs; the largest differences as a table.

    python benchmarks/foreign_fmus.py FOLDER [FOLDER ...]

Every FMI 2.0 co-simulation FMU below the folders that has outputs and a binary for this platform runs once, as a Markdown table.
Its Real inputs follow sines around their start values, held over the communication step; all of its Real parameters are 1 % off
their defaults, as far as their ranges go, or at their defaults where it doesn't run with that. The communication step is that of
the default experiment, else a 500th of its length (of 0.2 s where it has none); there are 500 of them at most. The difference is
relative to each output's largest value. Outputs that two runs in fmpy don't repeat (a clock, say) are left out. Our master reads
outputs before and after it sets inputs, fmpy before alone; for a difference there is also what remains of it when outputs are
read once. Equal lines are shown once.

    python benchmarks/foreign_fmus.py --exchange FOLDER [FOLDER ...]

The same for model exchange, of FMI 2.0 and 3.0 and without inputs: our integrator and fmpy's CVODE at the tolerance 1e-6, each against ours
at 1e-10, and CVODE at 1e-10 against that. Co-simulation is taken out of FMUs that have both.
"""

from __future__ import annotations

import hashlib
import re
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from itertools import count as counter
from math import inf
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.model_description import read_model_description

from flexfmu.cosim.cli.console import keep_stdout
from flexfmu.cosim.engine.child_process import in_child
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Call, Indices, RealArray, SlaveVariable

STEPS, LENGTH = 500, 0.2
"""Communication steps at most, and length of a run where the FMU names none [s]."""

CALL_LIMIT, RUN_LIMIT = 60.0, 600.0
"""Time limits of an FMU for one call, and of fmpy for one run [s]."""

TOLERANCE, TIGHT = 1e-6, 1e-10
"""Relative tolerance of the FMUs, and that of a reference."""

EQUAL = 1e-12
"""Relative difference that needs no explanation."""

WIDTH = 250
"""Characters of a cell."""

OFFSET = 0.1
"""Amplitude of an input, relative to its start value or to 1."""


class Sines:
    """Inputs of the FMU, sines around their start values; they jump at every point, so that outputs are recorded before
    they are set, as fmpy records them."""

    name = "sines"

    def __init__(self, inputs: Sequence[Any], times: RealArray, units: Sequence[str]) -> None:
        self.starts = np.array([float(each.start or 0.0) for each in inputs])
        self.variables = [SlaveVariable(f"u{i}", "output", unit) for i, unit in enumerate(units)]
        self.feedthrough = {each.name: () for each in self.variables}
        self.breakpoints = times.tolist()
        self.length, self.time = times[-1] - times[0], times[0]

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.time = start_time

    def set(self, indices: Indices, values: RealArray) -> None: ...

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.at(self.time)[indices]

    def step(self, time: float, step: float) -> None:
        self.time = time + step

    def at(self, time: float) -> RealArray:
        """(n,) values."""
        amplitudes = OFFSET * np.maximum(abs(self.starts), 1.0)
        return self.starts + amplitudes * np.sin(2.0 * np.pi * (time - self.breakpoints[0]) / self.length)


class ReadOnce(FmuSlave):
    """Its outputs are read once in a step, before its inputs are set."""

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        read, calls = super().bind_get(indices, values), counter()
        return lambda: None if next(calls) % 2 else read()


def found(folders: Sequence[str]) -> Iterator[Path]:
    """FMUs below the folders, each content once."""
    seen = set()
    for path in sorted(each for folder in folders for each in Path(folder).rglob("*.fmu")):
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if digest not in seen:
            seen.add(digest)
            yield path


def described(path: Path, exchange: bool) -> Any:
    """The model description; None where it isn't an FMU for this comparison."""
    try:
        platforms = fmpy.supported_platforms(str(path))
        description = read_model_description(str(path), validate=False)
    except Exception:
        return None
    suits = fmpy.platform in platforms or fmpy.platform_tuple in platforms
    if exchange:
        suits = suits and description.modelExchange and description.fmiVersion[0] in "23"
    else:
        suits = suits and description.fmiVersion == "2.0" and description.coSimulation
    return description if suits and any(v.causality == "output" for v in description.modelVariables) else None


def exporter(description: Any) -> str:
    """Tool that has made the FMU, without the number of its build."""
    tool = re.split(r",| \(|-dev|\.\d{8}", description.generationTool or "not stated")[0]
    return (
        re.sub(r" (Compiler OMCompiler|Compiler OpenModelica|Version)| v(?=\d)|(?<=Hopsan)", " ", tool)
        .replace("  ", " ")
        .strip()
    )


def points(description: Any) -> RealArray:
    """(N,) communication points [s]."""
    experiment = description.defaultExperiment
    start = float(getattr(experiment, "startTime", None) or 0.0)
    stop = float(getattr(experiment, "stopTime", None) or start + LENGTH)
    step = float(getattr(experiment, "stepSize", None) or (stop - start) / STEPS)
    count = max(1, min(STEPS, round((stop - start) / step)))
    return start + step * np.arange(count + 1)


def changed(description: Any) -> dict[str, Value]:
    """All Real parameters, 1 % off."""
    real = [v for v in description.modelVariables if v.causality == "parameter" and v.type == "Real" and v.start]
    values: dict[str, Value] = {}
    for each in real:
        value = 1.01 * float(each.start)
        if float(each.min or -inf) <= value <= float(each.max or inf):
            values[each.name] = value
    return values


def ours(
    path: Path, times: RealArray, inputs: Sequence[Any], starts: dict[str, Value], kind: type[FmuSlave] = FmuSlave
) -> tuple[RealArray, dict[str, RealArray], list[str], bool]:
    """Times and outputs in our master, what it says, and whether the run ended as it should."""
    slave = kind(path, "fmu", starts, input_order=0)
    slaves: list[Any] = [slave]
    if inputs:
        units = {each.name: each.unit for each in slave.variables}
        slaves.insert(0, Sines(inputs, times, [units[each.name] for each in inputs]))
    wires = [(f"sines.u{i}", f"fmu.{each.name}") for i, each in enumerate(inputs)]
    system, step, isolation = connect(slaves, wires), times[1] - times[0], CALL_LIMIT
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        run = simulate(system, times[-1], step, start=times[0], tolerance=TOLERANCE, isolation=isolation)
    time = run.recording.time
    before = np.flatnonzero(np.diff(time, prepend=-np.inf) > 0.0)
    outputs = {
        name.removeprefix("fmu."): column.values[before]
        for name, column in run.recording.columns.items()
        if name.startswith("fmu.") and column.texts is None
    }
    remarks = [] if run.outcome is Outcome.COMPLETED else [run.message.removeprefix("fmu ")]
    said = [str(warning.message).removeprefix("fmu: ") for warning in told]
    remarks += ["no output derivatives" for each in said if "maxOutputDerivativeOrder" in each]
    if calculated := [each for each in said if "ignores it or calculates it" in each]:
        remarks.append(f"calculated: {len(calculated)}")
    return time[before], outputs, remarks, not run.outcome.is_failure


def theirs(path: Path, times: RealArray, inputs: Sequence[Any], starts: dict[str, Value], names: Sequence[str]) -> Any:
    """Times and outputs in fmpy."""
    signals = None
    if inputs:
        sines = Sines(inputs, times, [""] * len(inputs))
        signals = np.array(
            [(time, *sines.at(time)) for time in times],
            dtype=[("time", float), *((each.name, float) for each in inputs)],
        )
    return fmpy.simulate_fmu(
        str(path),
        validate=False,
        fmi_type="CoSimulation",
        start_time=times[0],
        stop_time=times[-1],
        output_interval=times[1] - times[0],
        relative_tolerance=TOLERANCE,
        start_values=starts,
        input=signals,
        output=list(names),
    )


def apart(mine: Any, other: Any, names: Sequence[str], count: int) -> dict[str, float]:
    """Largest difference of each output over the first instants, relative to its largest value."""
    found = {}
    for name in names:
        values, reference = (np.asarray(each[name][:count], float) for each in (mine, other))
        largest = float(abs(reference).max(initial=0.0)) or 1.0
        found[name] = float(abs(values - reference).max(initial=0.0)) / largest
    return found


def one_line(error: str) -> str:
    """A cell of the table."""
    text = " ".join(str(error).split()).replace("|", "/")
    return text if len(text) < WIDTH else f"{text[:WIDTH]} ..."


def compared(path: Path, description: Any) -> str:
    """What ours gives against fmpy."""
    times = points(description)
    inputs = [v for v in description.modelVariables if v.causality == "input" and v.type == "Real"]
    names = [v.name for v in description.modelVariables if v.causality == "output" and v.type != "String"]
    time, mine, said = np.empty(0), {}, [""]
    for starts in (changed(description), {}):
        try:
            time, mine, said, ends_well = ours(path, times, inputs, starts)
        except CosimError as error:
            said, ends_well = [str(error).replace(f"{path.parent}/", "")], False
        if ends_well:
            break

    def other() -> Any:
        return in_child(lambda: theirs(path, times, inputs, starts, names), lambda: None, RUN_LIMIT)

    try:
        first = other()
    except Exception as error:
        if not time.size:
            return f"neither: {said[0]}"
        remarks = [*said, f"fmpy: {str(error).rpartition('/')[2]}"]
        return " | ".join((f"{time.size - 1} x {times[1] - times[0]:.3g} s", "ours only", "; ".join(remarks)))
    count = min(time.size, len(first))
    if not count:
        return f"fmpy only; ours: {said[0]}"
    worst = apart(mine, first, names, count)
    remarks = [f"parameters changed: {len(starts)}"] if starts else []
    remarks += said
    if max(worst.values(), default=0.0) > EQUAL:
        again = apart(first, other(), names, len(first))
        if fickle := [name for name in names if again[name] > 0.0]:
            remarks.append(f"without {', '.join(fickle)}, which fmpy doesn't repeat")
            worst = {name: value for name, value in worst.items() if name not in fickle}
    result = f"{max(worst.values(), default=0.0):.0e}"
    if max(worst.values(), default=0.0) > EQUAL:
        once = apart(ours(path, times, inputs, starts, ReadOnce)[1], first, list(worst), count)
        result += f" (read once: {max(once.values()):.0e})"
    if not all(np.isfinite(first[name].astype(float)).all() for name in names):
        remarks.append("NaN in fmpy")
    size = f"{count - 1} x {times[1] - times[0]:.3g} s, {len(inputs)} to {len(names)}"
    return " | ".join((size, result, "; ".join(remarks)))


def exchanged(path: Path, description: Any) -> str:
    """What our integrator and CVODE give in model exchange."""
    times = points(description)
    wanted = (v for v in description.modelVariables if v.causality == "output" and not v.dimensions)
    names = [v.name for v in wanted if v.type not in ("String", "Binary", "Clock")]
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder, path.name)
        with zipfile.ZipFile(path) as archive, zipfile.ZipFile(alone, "w") as without:
            for name in archive.namelist():
                content = archive.read(name)
                if name == "modelDescription.xml":
                    for kind in (b"CoSimulation", b"ScheduledExecution"):
                        content = re.sub(rb"<%s\b([^>]*/>|.*?</%s>)" % (kind, kind), b"", content, flags=re.DOTALL)
                without.writestr(name, content)

        def own(tolerance: float) -> tuple[RealArray, dict[str, RealArray]]:
            system = connect([FmuSlave(alone, "fmu")], [])
            run = simulate(
                system, times[-1], times[1] - times[0], start=times[0], tolerance=tolerance, isolation=CALL_LIMIT
            )
            if run.outcome.is_failure:
                raise CosimError(run.message)
            return run.recording.time, {name: run.recording[f"fmu.{name}"].values for name in names}

        def cvode(tolerance: float) -> Any:
            arguments = {"fmi_type": "ModelExchange", "record_events": False, "output": names, "validate": False}
            span = {"start_time": times[0], "stop_time": times[-1], "output_interval": times[1] - times[0]}
            action = lambda: fmpy.simulate_fmu(str(alone), relative_tolerance=tolerance, **arguments, **span)  # noqa: E731
            return in_child(action, lambda: None, RUN_LIMIT)

        try:
            time, reference = own(TIGHT)
            count, mine = time.size, own(TOLERANCE)[1]
        except CosimError as error:
            return f"not ours: {str(error).replace(str(folder), '')}"
        cells, remarks = [mine], []
        for tolerance in (TOLERANCE, TIGHT):
            try:
                cells.append(cvode(tolerance))
                count = min(count, len(cells[-1]))
            except Exception as error:
                remarks.append(f"fmpy: {str(error).rpartition('/')[2]}")
    apart_by = [f"{max(apart(each, reference, names, count).values(), default=0.0):.0e}" for each in cells]
    return " | ".join((f"{time.size - 1} x {times[1] - times[0]:.3g} s", ", ".join(apart_by), "; ".join(remarks)))


def main() -> None:
    """Run all, print the table."""
    keep_stdout()
    exchange = sys.argv[1:2] == ["--exchange"]
    heads = ("steps", "ours, CVODE, CVODE at 1e-10") if exchange else ("steps, inputs to outputs", "apart")
    print(
        f"fmpy {fmpy.__version__}, {fmpy.platform}\n\n| exporter | FMU | {' | '.join(heads)} | remarks |\n|---|---|---|---|---|",
        flush=True,
    )
    folders = sys.argv[2:] if exchange else sys.argv[1:]
    chosen = [(path, each) for path in found(folders) if (each := described(path, exchange)) is not None]
    lines = set()
    for path, description in sorted(chosen, key=lambda each: exporter(each[1])):
        result = (exchanged if exchange else compared)(path, description)
        cells = result.split(" | ") if " | " in result else ["", "", result]
        line = f"| {' | '.join(map(one_line, (exporter(description), path.stem, *cells)))} |"
        if line not in lines:
            print(line, flush=True)
        lines.add(line)


if __name__ == "__main__":
    main()
