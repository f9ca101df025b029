"""`flexfmu sweep`: many variants of a scene, resumable, as one table and picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

from flexfmu.cosim.cli.console import FAILURE, load_resolved, print_result, progress, show_note, usual_folder
from flexfmu.cosim.cli.options import ProcessesOption
from flexfmu.cosim.engine.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from flexfmu.cosim.studies.sweep.cases import Cases
    from flexfmu.cosim.studies.sweep.result import SweepResult
    from flexfmu.model.scene.schema import Scene


def sweep(
    scene: str,
    vary: list[str] | None = None,
    sample: str | None = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    cases: Path | None = None,
    metrics: list[str] | None = None,
    record: list[str] | None = None,
    record_step: float | None = None,
    processes: ProcessesOption = None,
    out: Path | None = None,
    restart: bool = False,
    dask: str | None = None,
    plot: bool | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Simulate many variants of a scene: writes sweep.csv (and sweep.parquet) with the metrics of each, and a picture.

    Every finished case is kept at once. After Ctrl-C or a crash the same command continues, and ends with the same
    table. A case that fails is a line with its message.

    Args:
        vary (KEY=VALUES): A key of the scene and its values: payload.mass=0:8:50 (from, to, number),
            trajectory.duration=0.3,0.4, controller.pd.derivative=50:200 (an interval for --sample). May be repeated: all
            combinations. Default: nothing.
        sample (METHOD:N): Instead of all combinations N cases of a Latin hypercube, lhs:1000, or of a Sobol sequence,
            sobol:1024. Default: all combinations.
        seed (N): Seed of the sample.
        cases (FILE.csv): Cases one by one: keys in the first line, a case in each other line; an empty cell leaves the scene's
            value. Default: those of --vary.
        metrics (NAMES): Metrics, separated by commas; may be repeated. Default: all.
        record (SIGNAL): Keep this signal of each case, in signals/; may be repeated. Default: none.
        record_step (SECONDS): Interval of the kept signals. Default: every instant.
        out (DIR): Folder of the results. Default: results/<name of the scene>-sweep.
        restart: Discard the results of another sweep in the folder. Default: refuse.
        dask (ADDRESS): Simulate on the workers of this Dask scheduler, tcp://host:8786. Default: this machine.
        plot: Draw sweep.png and sweep.svg. Default: draw them, but with --json don't.
    """
    from flexfmu.cosim.engine.results import Selection
    from flexfmu.cosim.studies.sweep.result import write_files
    from flexfmu.cosim.studies.sweep.sweep import sweep_scene

    robot = load_resolved(scene, settings)
    wanted = _cases(robot, vary or [], sample, seed, cases)
    if record_step is not None and not record:
        raise InputError("--record-step goes with --record SIGNAL")
    selection = Selection(list(dict.fromkeys(record)), step=record_step) if record else None
    names = None if metrics is None else [each.strip() for text in metrics for each in text.split(",")]
    folder = out or usual_folder(robot.name, settings, "-sweep")
    done, start = [0, 0], list[tuple[float, int]]()
    try:
        with progress() as show:

            def report(finished: int, total: int) -> None:
                """Show how much is finished and how long the rest takes, at the pace since the start."""
                done[:], left = (finished, total), ""
                start[:] = start or [(monotonic(), finished)]
                since, before = start[0]
                if finished > before:
                    seconds = (monotonic() - since) * (total - finished) / (finished - before)
                    minutes, hours = f"{seconds / 60.0:.0f} min", f"{seconds / 3600.0:.1f} h"
                    left = f", {f'{seconds:.0f} s' if seconds < 90.0 else minutes if seconds < 5400.0 else hours} left"
                show(f"{finished} of {total} cases{left}", finished / total if total else 1.0)

            result = sweep_scene(
                robot,
                wanted,
                metrics=names,
                record=selection,
                processes=processes,
                folder=folder,
                restart=restart,
                dask=dask,
                show=report,
            )
            show("writing the results", None)
            files = write_files(result, folder, plot=not json if plot is None else plot)
    except KeyboardInterrupt:
        show_note(f"interrupted: {done[0]} of {done[1]} cases are in {folder}; the same command continues")
        return FAILURE
    data = {
        "scene": result.name,
        "cases": len(result),
        "failed": [{"case": row["case"], "message": row["message"]} for row in result.failed],
        "metrics": result.summary(),
        "files": [str(path) for path in files],
    }
    print_result(json, data, *_shown(result, files))
    return FAILURE if len(result.messages) == len(result) else 0


def _cases(robot: Scene, vary: list[str], sample: str | None, seed: int, path: Path | None) -> Cases:
    """The cases by the options; notes on standard error tell what is left out.

    Raises:
        InputError: the options contradict each other, or one is of another form.
    """
    from flexfmu.cosim.studies.sweep.cases import make_cases, parse_vary, read_cases

    if path is not None:
        if vary or sample is not None:
            raise InputError("--cases has all cases: leave out --vary and --sample")
        found, notes = read_cases(path)
    else:
        varied = [parse_vary(option) for option in vary]
        twice = [key for i, (key, _) in enumerate(varied) if key in dict(varied[:i])]
        if twice:
            raise InputError(f"--vary {twice[0]} is there twice: give all of its values at once, {twice[0]}=1,2,3")
        found, notes = make_cases(dict(varied), sample, seed, robot)
    for note in notes:
        show_note(note)
    return found


def _shown(result: SweepResult, files: list[Path]) -> Iterator[RenderableType]:
    """The extremes of each metric, failed cases and files."""
    from rich.table import Column

    from flexfmu.cosim.engine.showing import shown_unit
    from flexfmu.cosim.metrics.metric_table import ALL_METRICS
    from flexfmu.cosim.reports.terminal import titled_table

    heads = ("smallest", "at", "median", "largest", "at")
    table = titled_table(
        f"{result.name}: {len(result)} cases over {', '.join(result.cases.keys)}",
        "metric",
        "name",
        "unit",
        *(each if each == "at" else Column(each, justify="right") for each in heads),
        stacks=True,
    )
    for name, each in result.summary().items():
        low, median, high = (f"{each[part]:.4g}" for part in ("min", "median", "max"))
        at_low, at_high = (result.case_text(each[part]) for part in ("min_case", "max_case"))
        label = ALL_METRICS[name].label if name in ALL_METRICS else ""
        table.add_row(label, name, shown_unit(each["unit"]), low, at_low, median, high, at_high)
    yield table
    if failed := result.failed:
        yield f"{len(failed)} failed, the first with {result.case_text(failed[0]['case'])}: {failed[0]['message']}"
    yield f"results: {', '.join(map(str, files))}"
