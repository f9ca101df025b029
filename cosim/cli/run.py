"""`flexfmu run`: co-simulate a scene or an SSP file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flexfmu.cosim.cli.console import end_loading
from flexfmu.cosim.cli.options import run_option
from flexfmu.cosim.engine.errors import InputError


def run(
    scene: str,
    out: Path | None = None,
    step: Annotated[float | None, run_option("communication_step")] = None,
    stop_time: float | None = None,
    ssd: str | None = None,
    output_order: Annotated[int | None, typer.Option(min=0)] = None,
    isolate: Annotated[bool | None, run_option("isolate", "--isolate/--no-isolate")] = None,
    verify: bool | None = None,
    report: bool | None = None,
    record: list[str] | None = None,
    record_step: float | None = None,
    record_order: Annotated[int | None, typer.Option(min=0, max=2)] = None,
    formats: list[str] | None = None,
    yes: Annotated[bool, run_option("accept_size", "--yes")] = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Co-simulate a scene: writes results.csv, summary.json and report.html, prints the metrics.

    The FMU is built first unless it is in the cache. A companion run with shorter communication steps and a tighter
    tolerance gives the errors of the metrics; --no-verify saves it. An SSP file, ours or not, gives results.csv and summary.json.

    Args:
        scene (SCENE): A scene file (TOML), the name of a shipped scene: barnard2012-6kg, barnard2012-0.1kg; or an SSP file.
        out (DIR): Folder of the results. Default: results/<name of the scene>.
        stop_time (SECONDS): End of an SSP file's run. Default: what the file says, or the FMUs in it.
        ssd (NAME): System of an SSP file that holds several. Default: SystemStructure.ssd.
        output_order (N): Highest output derivative that FMUs of an SSP file are asked for, 0 for none. Default: what they give.
        verify: Verify the errors of the metrics by a second companion run. Default: take them from one.
        report: Draw report.html. Default: draw it, but with --json don't.
        record (SIGNAL): Record this signal alone; may be repeated. Default: what the scene says, or all.
        record_step (SECONDS): Interval of the recorded instants. Default: what the scene says, or every communication point.
        record_order (N): Number of recorded derivatives. Default: what the scene says, or 2.
        formats (--format NAME): Format of the recorded signals: csv, parquet, mat (MATLAB) or mcap (Foxglove, PlotJuggler); may
            be repeated. Default: csv.
    """
    from zipfile import is_zipfile

    chosen = tuple(dict.fromkeys(formats or ("csv",)))
    if scene.lower().endswith(".ssp") or is_zipfile(scene):
        if report:
            raise InputError("--report goes with a scene; an SSP file has no report")
        if record or record_step is not None or record_order is not None:
            raise InputError("--record, --record-step and --record-order go with a scene")
        if settings:
            raise InputError(f"--set {settings[0]} goes with a scene; parameters of an SSP file are in the file")
        from flexfmu.cosim.cli.run_ssp import run_ssp_command

        end_loading()
        return run_ssp_command(Path(scene), out, step, stop_time, json, isolate, ssd, output_order, chosen)
    # options that a scene doesn't have
    if stop_time is not None:
        raise InputError("--stop-time goes with an SSP file; a scene ends with its motion and `trajectory.dwell`")
    if ssd is not None:
        raise InputError("--ssd goes with an SSP file; a scene is one system")
    if output_order is not None:
        raise InputError("--output-order goes with an SSP file; in a scene each FMU has its own `output_order`")
    from flexfmu.cosim.cli.run_scene import run_command

    end_loading()
    return run_command(
        scene,
        out,
        json,
        {"communication_step": step, "isolate": isolate, "accept_size": yes},
        companions=1 if verify is None else 2 * verify,
        has_report=not json if report is None else report,
        recorded=(record, record_step, record_order),
        formats=chosen,
        changes=settings,
    )
