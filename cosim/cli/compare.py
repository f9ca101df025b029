"""`flexfmu compare`: runs, scenes and a measurement side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.cli.console import FAILURE, print_rich, print_text, progress, show_note
from flexfmu.cosim.engine.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from flexfmu.cosim.studies.compare.comparison import Comparison


def compare(
    runs: list[str],
    measured: Path | None = None,
    mapping: list[str] | None = None,
    delay: float | None = None,
    variant: list[str] | None = None,
    payload_band: str | None = None,
    settings: list[str] | None = None,
    out: Path | None = None,
    json: bool = False,
) -> int:
    """Compare runs with each other and with a measurement: metrics side by side, signals over each other, spectra.

    Differences are relative to the first run. Scenes with different controllers or shapers have their margins, processor times and
    the worst over a band of payloads side by side, too. A measurement is aligned in time with it; RMS, mean and largest difference of each
    signal are those over the time that both have.

    Args:
        runs (RUN): A folder of results, a results file (.csv, .parquet, .mat), or a scene, which is run now; NAME=SCENE gives it
            another name.
        measured (LOG.csv): A measurement: a CSV file with a header and a column `time`. Columns named like signals are
            compared. Default: none.
        mapping (--map COLUMN=SIGNAL): What a measured column is, with a factor or a unit and an offset if needed:
            tau1=joint1.torque*1e-3, phi=joint1.position*deg+0.5, t=time*ms. May be repeated. Default: by the names.
        delay (SECONDS): Time of an event in the measurement minus that in the simulation. Default: estimated by correlation.
        variant (NAME:KEY=VALUE): The first scene with other values, as one more run; several with commas:
            stiff:pd.kp=2e4,pd.kd=200. May be repeated. Default: none.
        payload_band (BAND): Run scenes with other payloads too, which controllers don't know: 0.2 for 20 % to both sides, or
            4,8 for 4 and 8 kg. Default: not.
        out (DIR): Write comparison.html and comparison.json there. Default: nowhere.
    """
    from flexfmu.cosim.design.gains.robustness import parse_band
    from flexfmu.cosim.engine.files import OutputFolder
    from flexfmu.cosim.reports.text import to_json
    from flexfmu.cosim.studies.compare.comparison import compare_runs
    from flexfmu.cosim.studies.compare.measured import parse_mapping
    from flexfmu.cosim.studies.compare.sources import compared_runs, given_sources

    # what can be wrong is checked before anything is simulated
    meaning = dict(map(parse_mapping, mapping or ()))
    if measured is not None and not measured.is_file():
        raise InputError(f"there is no file {measured}")
    if out is not None:
        OutputFolder(out).prepare()
    band = None if payload_band is None else parse_band(payload_band)
    sources = given_sources(runs, variant or (), settings or ())
    with progress() as show:
        found = compare_runs(compared_runs(sources, show, band), measured, meaning, delay)
    if out is not None:
        found.write(out)
    if json:
        print_text(to_json(found.as_data()))
    else:
        _print(found, out)
    failed = [run for run in found.runs if run.failure]
    for run in failed:
        show_note(f"{run.name}{'' if run.metrics else ' failed'}: {run.failure}")
    return FAILURE if failed else 0


def _print(found: Comparison, out: Path | None) -> None:
    """The tables of the page, and where it is."""
    from rich.text import Text

    from flexfmu.cosim.reports.terminal import as_terminal_table
    from flexfmu.cosim.studies.compare.comparison import POORLY, delay_text

    parts: list[RenderableType] = [as_terminal_table(table) for table in found.tables()]
    measured = found.measured
    if measured is not None:
        parts.append(Text(f"{measured.name} is {delay_text(measured.delay)}"))
        if measured.delay.correlation < POORLY:
            warning = "warning: measurement and simulation hardly look alike; check --map, signs and --delay"
            parts.append(Text(warning, style="yellow"))
    if out is not None:
        parts.append(Text(f"comparison.html and comparison.json are in {out}"))
    print_rich(*parts)
