"""`flexfmu run` of an SSP file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.cli.console import (
    FAILURE,
    check_formats,
    files_sentence,
    print_rich,
    print_text,
    progress,
    show_note,
    write_results,
)
from flexfmu.cosim.engine.files import RESULTS, OutputFolder
from flexfmu.cosim.engine.master.simulator import Simulation
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.exchange.ssp.archive import DESCRIPTION
from flexfmu.cosim.exchange.ssp.loading import SspSystem, load_ssp
from flexfmu.cosim.experiment.recording import slave_facts
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.cosim.reports.text import to_json

TEXT_WIDTH = 40
"""Characters of a text in the table of results."""


def run_ssp_command(
    source: Path,
    out: Path | None,
    step: float | None,
    stop_time: float | None,
    as_json: bool,
    isolate: bool | None = None,
    ssd: str | None = None,
    output_order: int | None = None,
    formats: Sequence[str] = ("csv",),
) -> int:
    """Simulate an SSP file, write results.csv and summary.json, and print how the run ended; the exit status.

    What was recorded before a failure is written too. ``step`` and ``stop_time`` [s] replace the file's own, ``ssd`` names one of
    several systems in it, ``output_order`` is the highest output derivative of its FMUs that is read, ``formats`` are those of the recorded signals.
    """
    check_formats(formats)
    loaded = load_ssp(source, stop=stop_time, step=step, ssd=ssd or DESCRIPTION, output_order=output_order)
    folder = OutputFolder(out or RESULTS / source.stem)
    folder.prepare()
    # simulate, and write what was recorded even if it failed
    with progress() as show:
        simulation = loaded.simulate(progress=lambda fraction: show("simulating", fraction), isolate=isolate)
        show("writing the results", None)
        about = {"system": loaded.structure.name, "outcome": simulation.message}
        files = [*write_results(folder, simulation.recording, formats, about), "summary.json"]
        summary = _summary(loaded, simulation)
        folder.write("summary.json", to_json(summary))
    # standard output
    if as_json:
        print_text(to_json(summary))
    else:
        _print(summary, simulation, files_sentence(files, folder.path))
    if simulation.outcome.is_failure:
        show_note(f"{simulation.message}; what was recorded is in {folder.path}")
        return FAILURE
    return 0


def _summary(loaded: SspSystem, simulation: Simulation) -> Mapping[str, Any]:
    """What was run and how it ended."""
    time = simulation.recording.time
    return {
        "system": loaded.structure.name,
        "outcome": simulation.outcome.name.lower(),
        "message": simulation.message,
        "start_time": loaded.start,
        "stop_time": loaded.stop,
        "end_time": float(time[-1]) if time.size else None,
        "communication_step": loaded.step,
        "steps": simulation.steps,
        "slaves": [
            {"name": each.name, "sample_time": each.sample_time, "offset": each.offset}
            for each in slave_facts(loaded.system.slaves)
        ],
        "connections": [loaded.system.describe(each) for each in loaded.system.connections],
        "ignored_parameters": list(loaded.ignored),
        "remarks": list(loaded.remarks),
        "units": simulation.recording.units,
    }


def _print(summary: Mapping[str, Any], simulation: Simulation, where: str) -> None:
    """The outputs' ranges, how the run ended, and where the files are."""
    parts: list[RenderableType] = [_ranges(summary["system"], simulation)]
    parts.append(
        Text(f"{simulation.message}: {summary['end_time'] or 0.0:g} s in steps of {summary['communication_step']:g} s")
    )
    if summary["ignored_parameters"]:
        names = ", ".join(summary["ignored_parameters"])
        parts.append(Text(f"warning: parameters that fit no variable were ignored: {names}", style="yellow"))
    parts += [Text(f"warning: {remark}", style="yellow") for remark in summary["remarks"]]
    parts.append(Text(where))
    print_rich(*parts)


def _ranges(title: str, simulation: Simulation) -> Table:
    """Smallest, largest and last value of every output; of a text the last alone."""
    table = titled_table(title, "Output", numbers=("Smallest", "Largest", "Last"))
    for name, column in simulation.recording.columns.items():
        if column.values.size and column.texts is not None:
            # texts have no order; long ones and line breaks stay in results.csv
            last = " ".join(column.text_at(-1).split())
            table.add_row(Text(name), "", "", Text(f'"{last[:TEXT_WIDTH]}{"..." if len(last) > TEXT_WIDTH else ""}"'))
        elif column.values.size:
            values = column.values.min(), column.values.max(), column.values[-1]
            table.add_row(Text(f"{name} [{shown_unit(column.unit) or '-'}]"), *(f"{value:.6g}" for value in values))
    return table
