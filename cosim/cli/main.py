"""The command line: what can be typed and what it says about itself. The work is done in `flexfmu.cosim.cli`.

They are imported when their command runs: CasADi, SciPy and Matplotlib are too slow to load for ``--help``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from flexfmu.cosim.cli.console import FAILURE, one_line_errors, orderly_termination, show_error

app = typer.Typer(
    name="flexfmu",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit status: 0 done, 1 it ran and failed, 2 wrong usage or input, 143 ended by SIGTERM. Results go to "
    "standard output, progress to standard error.",
)

_SCENE = typer.Argument(
    metavar="SCENE",
    help="A scene file (TOML), or the name of a shipped scene: barnard2012-6kg, barnard2012-0.1kg.",
    show_default=False,
)
SceneArgument = Annotated[str, _SCENE]
OptionalScene = Annotated[str | None, _SCENE]
NamingOption = Annotated[
    str,
    typer.Option(
        metavar="CONVENTION",
        help="structured (link11.bending[1]) or flat (link11_bending_1), for tools that need it.",
    ),
]
PlatformOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="linux64, win64, darwin64, aarch64-linux or aarch64-darwin; may be repeated. Default: this machine's.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")]


def main() -> None:
    """Entry point of the command ``flexfmu``."""
    from flexfmu.cosim.cli.console import keep_stdout

    keep_stdout()
    try:
        with orderly_termination():
            app()
    except OSError as error:  # a help text that can't be written; the commands catch their own
        from flexfmu.cosim.cli.console import abandon_stdout

        abandon_stdout()
        show_error(f"can't write to standard output: {error.strerror or error}")
        sys.exit(FAILURE)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        from flexfmu.cosim.cli.console import print_text

        with one_line_errors():
            print_text(f"flexfmu {version('flexfmu')}\n")
        raise typer.Exit


@app.callback()
def _flexfmu(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Build the model of a flexible five-bar robot as an FMU, and co-simulate pick-and-place motions with it."""


@app.command()
def build(
    scene: SceneArgument,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.fmu", help="Default: the scene's name, here.")
    ] = None,
    platform: PlatformOption = None,
    naming: NamingOption = "structured",
    enumerations: Annotated[
        bool,
        typer.Option(
            "--enumerations",
            help="Make initial and integrator FMI enumerations. Default: Integers, since Maestro refuses them.",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Build the FMI 2.0 FMU of a scene, for co-simulation and model exchange."""
    with one_line_errors():
        from flexfmu.cosim.cli.fmu import build_command

        raise typer.Exit(build_command(scene, output, platform or [], naming, enumerations, json))


@app.command()
def fmus(
    scene: SceneArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the FMUs. Default: results/<name of the scene>/fmus.")
    ] = None,
    slave: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Name of a slave in the scene; may be repeated. Default: all of them."),
    ] = None,
    platform: PlatformOption = None,
    naming: NamingOption = "structured",
    json: JsonOption = False,
) -> None:
    """Export a scene's slaves as FMUs: robot, trajectory, controllers, shapers and imperfections.

    With --json it also lists the connections between them.
    """
    with one_line_errors():
        from flexfmu.cosim.cli.fmus import fmus_command

        raise typer.Exit(fmus_command(scene, out, slave or [], platform or [], naming, json))


@app.command()
def export(
    scene: SceneArgument,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.ssp", help="Default: the scene's name, here.")
    ] = None,
    platform: PlatformOption = None,
    json: JsonOption = False,
) -> None:
    """Write a whole scene as one SSP 1.0 file: its FMUs, their connections and parameters.

    Other tools simulate the file as it is; here: flexfmu run FILE.ssp.
    """
    with one_line_errors():
        from flexfmu.cosim.cli.export import export_command

        raise typer.Exit(export_command(scene, output, platform or [], json))


@app.command()
def run(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE",
            help="A scene file (TOML), the name of a shipped scene: barnard2012-6kg, barnard2012-0.1kg; or an SSP file.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results. Default: results/<name of the scene>.")
    ] = None,
    step: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Communication step. Default: what the scene or file says.")
    ] = None,
    stop_time: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="End of an SSP file's run. Default: what the file says, or the FMUs in it.",
            show_default=False,
        ),
    ] = None,
    ssd: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="System of an SSP file that holds several. Default: SystemStructure.ssd."),
    ] = None,
    output_order: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=0,
            help="Highest output derivative that FMUs of an SSP file are asked for, 0 for none. Default: what they give.",
            show_default=False,
        ),
    ] = None,
    isolate: Annotated[
        bool | None,
        typer.Option(
            "--isolate/--no-isolate",
            help="Simulate in a child process, so that a slave that crashes, exits or hangs ends the run alone. Default: what the "
            "scene says, or where other tools' FMUs or Python slaves take part.",
            show_default=False,
        ),
    ] = None,
    verify: Annotated[
        bool | None,
        typer.Option(
            "--verify/--no-verify",
            help="Verify the errors of the metrics by a second companion run. Default: take them from one.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Co-simulate a scene: writes results.csv, summary.json and report.html, prints the metrics.

    The FMU is built first unless it is in the cache. A companion run with shorter communication steps and a tighter
    tolerance gives the errors of the metrics; --no-verify saves it. An SSP file, ours or not, gives results.csv and summary.json.
    """
    with one_line_errors():
        from zipfile import is_zipfile

        from flexfmu.cosim.cli.run import run_command
        from flexfmu.cosim.engine.errors import InputError

        if scene.lower().endswith(".ssp") or is_zipfile(scene):
            from flexfmu.cosim.cli.export import run_ssp_command

            raise typer.Exit(run_ssp_command(Path(scene), out, step, stop_time, json, isolate, ssd, output_order))
        if stop_time is not None:
            raise InputError("--stop-time goes with an SSP file; a scene ends with its motion and `trajectory.dwell`")
        if ssd is not None:
            raise InputError("--ssd goes with an SSP file; a scene is one system")
        if output_order is not None:
            raise InputError("--output-order goes with an SSP file; in a scene each FMU has its own `output_order`")
        raise typer.Exit(run_command(scene, out, json, step, isolate, 1 if verify is None else 2 * verify))


@app.command()
def paper(
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results. Default: results/paper.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Repeat the paper's experiment: every table beside the printed one, and the figures.

    Barnard, Briot and Caro, "Trajectory Generation for High Speed Pick-and-Place Robots", ESDA 2012.
    """
    with one_line_errors():
        from flexfmu.cosim.cli.paper import paper_command

        raise typer.Exit(paper_command(out, json))


@app.command()
def modes(
    scene: SceneArgument,
    poses: Annotated[
        int,
        typer.Option(
            metavar="N", min=3, max=10_001, help="Poses along the path: an odd number, so that the middle is one."
        ),
    ] = 11,
    json: JsonOption = False,
) -> None:
    """Natural frequencies along the path, with the motors locked, about the static equilibrium."""
    with one_line_errors():
        from flexfmu.cosim.cli.modes import modes_command

        raise typer.Exit(modes_command(scene, poses, json))


@app.command()
def effects(
    scene: SceneArgument,
    tolerance: Annotated[
        float | None, typer.Option(metavar="RELATIVE", help="Largest error. Default: the scene's, or 0.01.")
    ] = None,
    of: Annotated[
        list[str] | None,
        typer.Option(
            metavar="METRIC", help="A metric to hold; may be repeated. Default: the scene's, or three of them."
        ),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Run the chosen set beside the next richer ones; builds their FMUs.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Choose the cheapest elastic effects within a tolerance; shows what each is worth and what it costs."""
    with one_line_errors():
        from flexfmu.cosim.cli.effects import effects_command

        raise typer.Exit(effects_command(scene, tolerance, of or [], check, json))


@app.command()
def shaper(
    scene: SceneArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results. Default: results/<name of the scene>.")
    ] = None,
    payload_errors: Annotated[
        bool,
        typer.Option("--payload-errors", help="Seven payload errors instead of five; writes payload_errors.md too."),
    ] = False,
    payload_band: Annotated[
        float, typer.Option(metavar="FRACTION", help="Largest error of the payload's mass, either way.")
    ] = 0.3,
    drive: Annotated[
        Literal["perfect", "controller"] | None,
        typer.Option(
            help="What drives the robot: exactly its references, or the scene's controllers and imperfections. "
            "Default: the controllers where the scene has some.",
            show_default=False,
        ),
    ] = None,
    max_deviation: Annotated[
        float | None, typer.Option(metavar="METRES", help="Largest deviation from the path. Default: no limit.")
    ] = None,
    max_added_time: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Longest time that the shaper may add. Default: no limit.")
    ] = None,
    max_jerk: Annotated[
        float | None, typer.Option(metavar="RAD/S3", help="Largest jerk of a joint reference. Default: no limit.")
    ] = None,
    max_torque: Annotated[
        float | None,
        typer.Option(metavar="N.M", help="Largest torque of a motor over the payload band. Default: no limit."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.toml", help="Write the scene with the recommended shaper here."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Design input shapers for a scene, try them all in co-simulation and recommend one, with the TOML that applies it.

    Writes shapers.json, shapers.csv and the picture: sensitivity, and the vibration before and after.
    """
    with one_line_errors():
        from flexfmu.cosim.choices.shapers.recommendation import Limits
        from flexfmu.cosim.cli.shaper import shaper_command

        limits = Limits(max_deviation, max_added_time, max_jerk, max_torque)
        raise typer.Exit(shaper_command(scene, out, json, payload_errors, payload_band, drive, limits, output))


@app.command()
def workprec(
    scene: OptionalScene = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the results. Default: results/<name of the scene>/workprec or results/hard-cases.",
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FAMILY",
            help="integrators, communication, algorithms, effects, formulations or tools; with --hard a part of a case's "
            "name; may be repeated. Default: all.",
        ),
    ] = None,
    hard: Annotated[
        bool,
        typer.Option(
            "--hard", help="Run the hard cases instead, without SCENE: what makes each hard, and what happened."
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Measure what accuracy costs in time: by integrator, communication step, coupling, effects, formulation and tool.

    Writes workprec.json, workprec.md, workprec.html and pictures. Takes some minutes.

    With --hard, run cases that simulations of this robot are most likely to get wrong; exit status 1 if one fails. Writes
    hard-cases.json and hard-cases.md.
    """
    with one_line_errors():
        from flexfmu.cosim.cli.workprec import hard_command, workprec_command

        raise typer.Exit((hard_command if hard else workprec_command)(scene, out, only or [], json))


@app.command()
def validate(
    fmu: Annotated[
        Path, typer.Argument(metavar="FILE.fmu", help="The FMU to check.", show_default=False, readable=False)
    ],
    static: Annotated[bool, typer.Option("--static", help="Only look at the file, don't run what is in it.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit status 1 for warnings too.")] = False,
    time_limit: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=1.0,
            help="Longest time for what runs the FMU, 120 s by default; one FMI call may take a fifth of it.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Check any FMU 2.0: archive, description, binaries, and each claim tried for real.

    Of an FMU 3.0 the description alone is checked.

    Prints one line for each kind of finding, the worst first: what is wrong, the remedy, the section of the standard.

    Exit status 1 if there is an error, 2 if the file is no FMU.
    """
    with one_line_errors():
        from flexfmu.cosim.cli.fmu import validate_command

        raise typer.Exit(validate_command(fmu, json, time_limit, not static, strict))
