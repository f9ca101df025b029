"""`flexfmu build`, `fmus`, `export` and `validate`: the FMU of a scene's robot, every slave of a scene as an FMU, a scene as one SSP file,
and checks of any FMU."""

from __future__ import annotations

from dataclasses import asdict
from math import gcd, lcm
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flexfmu.cosim.cli.console import (
    FAILURE,
    load_changed,
    load_resolved,
    print_rich,
    print_text,
    progress,
    show_note,
    usual_folder,
)
from flexfmu.cosim.cli.options import naming_convention
from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.cosim.reports.text import to_json
from flexfmu.fmu_build.errors import ArchiveError

if TYPE_CHECKING:
    from fractions import Fraction

    from rich.table import Table

    from flexfmu.cosim.engine.master.system import System
    from flexfmu.cosim.exchange.slave_export import ExportedSystem


def build(
    scene: str,
    output: Path | None = None,
    platform: list[str] | None = None,
    naming: str = "structured",
    enumerations: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Build the FMI 2.0 FMU of a scene, for co-simulation and model exchange.

    Args:
        output (--output, -o FILE.fmu): Default: the scene's name, here.
        enumerations: Make initial and integrator FMI enumerations. Default: Integers, since Maestro refuses them.
    """
    from flexfmu.cosim.experiment.scene_build import build_scene
    from flexfmu.model.choice_text import choice_sentence

    # choose effects where the scene leaves them open, then build
    convention = naming_convention(naming)
    robot = load_changed(scene, settings)
    target = output or Path(f"{robot.name}.fmu")
    with progress() as show:
        if robot.effects.select is not None:
            from flexfmu.cosim.design.effects.choice import resolved

            robot = resolved(robot, show)
        built = build_scene(
            robot,
            output=target,
            platforms=platform or None,
            naming=convention,
            enumerations=enumerations,
            progress=lambda text: show(text, None),
        )
    # standard output
    if json:
        from flexfmu.cosim.reports.summary import choice_summary

        choice = choice_summary(robot)
        chosen = {"effect_choice": choice} if choice else {}
        print_text(to_json(asdict(built) | {"path": str(built.path)} | chosen))
        return 0
    if robot.effects.choice is not None:
        print_text(f"{choice_sentence(robot)}\n")
    origin = "taken from the cache" if built.cached else "built"
    print_text(
        f"{built.path}: {origin} in {built.seconds:.2f} s, {built.fmu_bytes / 1000:.0f} kB "
        f"({built.code_bytes / 1000:.0f} kB of generated C), GUID {built.guid}\n"
    )
    return 0


def fmus(
    scene: str,
    out: Path | None = None,
    slave: list[str] | None = None,
    platform: list[str] | None = None,
    naming: str = "structured",
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Export a scene's slaves as FMUs: robot, trajectory, controllers, shapers and imperfections.

    With --json it also lists the connections between them.

    Args:
        out (DIR): Folder of the FMUs. Default: results/<name of the scene>/fmus.
        slave (NAME): Name of a slave in the scene; may be repeated. Default: all of them.
    """
    from flexfmu.cosim.exchange.slave_export import export_slaves

    # choose effects where the scene leaves them open, then export
    convention = naming_convention(naming)
    robot = load_resolved(scene, settings)
    folder = out or usual_folder(robot.name, settings) / "fmus"
    with progress() as show:
        show("building the FMU of the robot", None)
        system = export_slaves(
            robot, folder, names=slave or None, platforms=platform or None, naming=convention, progress=show
        )
    # standard output
    if json:
        print_text(to_json(_facts(system)))
    else:
        from rich.text import Text

        connected = f"connections between them: {len(system.connections)}, listed by --json"
        print_rich(_table(system), Text(f"{folder}: {len(system.slaves)} FMUs; {connected}"))
    return 0


def _facts(system: ExportedSystem) -> dict[str, object]:
    """What `--json` prints."""
    # slaves by the names that the connections refer to
    slaves = [
        {
            "name": each.name,
            "description": each.facts.description,
            "fmu": str(each.path),
            "sample_time": each.facts.sample_time,
            "offset": each.facts.offset,
            "parameters": dict(each.parameters),
        }
        for each in system.slaves
    ]
    connections = [{"from": source, "to": target} for source, target in system.connections]
    return {"slaves": slaves, "connections": connections, "step": system.step, "stop_time": system.stop_time}


def _table(system: ExportedSystem) -> Table:
    """A line for each slave."""
    from rich.text import Text

    from flexfmu.cosim.reports.terminal import titled_table

    table = titled_table("", "FMU", "what it is", "sample time", "set before the start")
    for each in system.slaves:
        sample_time = "" if each.facts.sample_time is None else f"{each.facts.sample_time:g} s"
        starts = ", ".join(f"{name} = {value}" for name, value in each.parameters.items())
        table.add_row(Text(each.path.name), Text(each.facts.description), sample_time, Text(starts))
    return table


def export(
    scene: str,
    output: Path | None = None,
    platform: list[str] | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Write a whole scene as one SSP 1.0 file: its FMUs, their connections and parameters.

    Other tools simulate the file as it is; here: flexfmu run FILE.ssp.

    Args:
        output (--output, -o FILE.ssp): Default: the scene's name, here.
    """
    from flexfmu.cosim.exchange.ssp.export import export_ssp
    from flexfmu.cosim.exchange.ssp.loading import load_ssp

    robot = load_resolved(scene, settings)
    target = output or Path(f"{robot.name}.ssp")
    with progress() as show:
        export_ssp(robot, target, platforms=platform or None, progress=show)
    if robot.cosimulation.drive == "torque":
        _note_late_samples(load_ssp(target).system)
    # standard output
    size = target.stat().st_size
    if json:
        print_text(to_json({"path": str(target), "bytes": size}))
    else:
        print_text(f"{target}: {size / 1000:.0f} kB, SSP 1.0; run it with: flexfmu run {target}\n")
    return 0


def _note_late_samples(system: System) -> None:
    """Say which samples other masters pass on a sample late: outputs that follow inputs at once, to slaves that sample
    at the same instants. What they are is in docs/ssp.md."""
    from fractions import Fraction

    from flexfmu.cosim.engine.slave import Sampled, feedthrough, offset

    # sample time and offset [s], as the decimals that they are written as
    clocks = {
        index: (Fraction(repr(float(slave.sample_time))), Fraction(repr(float(offset(slave)))))
        for index, slave in enumerate(system.slaves)
        if isinstance(slave, Sampled)
    }
    # connections with direct feedthrough between slaves whose clocks meet
    late: dict[str, None] = {}
    for each in system.connections:
        source = system.slaves[each.source]
        follows = feedthrough(source)[source.variables[each.output].name]
        if follows and {each.source, each.target} <= clocks.keys() and _meet(clocks[each.source], clocks[each.target]):
            late[f"{source.name} -> {system.slaves[each.target].name}"] = None
    if late:
        show_note(
            f"note: {', '.join(late)} sample at the same instants: masters that read all outputs before they set inputs "
            "(libcosim, ecos, Maestro, fmpy) pass these signals on a sample late; give what is fed an `offset` of a "
            "communication step (docs/ssp.md)"
        )


def _meet(first: tuple[Fraction, Fraction], second: tuple[Fraction, Fraction]) -> bool:
    """Whether two clocks ever sample at the same instant: their offsets differ by common parts of their sample times."""
    from fractions import Fraction

    (time, begin), (other_time, other_begin) = first, second
    part = Fraction(gcd(time.numerator, other_time.numerator), lcm(time.denominator, other_time.denominator))
    return (begin - other_begin) % part == 0


def validate(
    fmu: Annotated[Path, typer.Argument(readable=False)],
    static: bool = False,
    strict: bool = False,
    time_limit: Annotated[float | None, typer.Option(min=1.0)] = None,
    json: bool = False,
) -> int:
    """Check any FMU 2.0: archive, description, binaries, and a test of each capability that it claims.

    For an FMU 3.0 only the description is checked.

    Prints one line for each kind of finding, the worst first: what is wrong, the remedy, the section of the standard.

    Exit status 1 if there is an error, 2 if the file is no FMU.

    Args:
        fmu (FILE.fmu): The FMU to check.
        static: Only look at the file, don't run what is in it. Default: both.
        strict: Exit status 1 for warnings too. Default: for errors.
        time_limit (SECONDS): Longest time for what runs the FMU, one FMI call may take a fifth of it. Default: 120.
    """
    from flexfmu.fmu_build.validation.finding import Finding, Severity
    from flexfmu.fmu_build.validation.validate import TIME_LIMIT, validate_fmu

    limit = time_limit or TIME_LIMIT

    def as_json(findings: list[Finding]) -> str:
        return to_json({"fmu": str(fmu), "time_limit": limit, "findings": [asdict(finding) for finding in findings]})

    # a file that is no archive is an error here, in JSON a finding too
    try:
        with progress() as show:
            show(f"checking {fmu.name}, at most {limit:g} s", None)
            findings = validate_fmu(fmu, limit, not static)
    except ArchiveError as error:
        if json:
            print_text(as_json([Finding("archive", str(error))]))
        raise FmuFileError(str(error)) from error
    # standard output
    if json:
        print_text(as_json(findings))
    elif findings:
        print_text("".join(f"{finding}\n" for finding in findings))
    else:
        print_text(f"{fmu}: no findings\n")
    fatal = {Severity.ERROR, Severity.WARNING} if strict else {Severity.ERROR}
    return FAILURE if any(finding.severity in fatal for finding in findings) else 0
