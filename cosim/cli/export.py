"""`flexfmu build`, `fmus`, `export`, `validate`, `wrap` and `cache`: the FMU of the robot of a scene, every slave of a scene as an FMU, a scene as
one SSP file, checks of any FMU, FMUs for model exchange with an integrator, and where built FMUs are kept."""

from __future__ import annotations

from dataclasses import asdict
from math import gcd, inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexfmu.cosim.cli import console
from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.naming import Naming
from flexfmu.fmu_build.toolchain import FmiVersion

if TYPE_CHECKING:
    from rich.table import Table

    from flexfmu.cosim.engine.master.system import System
    from flexfmu.cosim.exchange.slave_export import ExportedSystem
    from flexfmu.fmu_build.build import BuiltFmu


def build(
    scene: str,
    output: Path | None = None,
    platform: list[str] | None = None,
    naming: Naming = "structured",
    enumerations: bool = False,
    fmi: FmiVersion = "2",
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Build the FMI 2.0 or 3.0 FMU of a scene, or of a model from equations, for co-simulation and model exchange.

    Args:
        scene (SCENE): A scene, or MODEL.py:NAME, a Python file, which is run, and the name of its model from flexfmu.ode, second_order, lagrangian
            or dae.
        output (--output, -o FILE.fmu): A file, with --platform wasm32 a folder. Default: the scene's or model's name, here.
        enumerations: Make initial and integrator FMI enumerations. Default: Integers, since Maestro refuses them.
    """
    from flexfmu.cosim.experiment.scene_build import build_scene
    from flexfmu.cosim.reports.summary import choice_summary
    from flexfmu.fmu_build.build import build_fmu
    from flexfmu.model.choice_text import choice_sentence

    suffix, model = "" if platform == ["wasm32"] else ".fmu", console.own_model(scene, settings)
    robot = console.load_changed(scene, settings) if model is None else None
    with console.progress() as show:
        options: dict[str, Any] = {
            "platforms": platform or None,
            "naming": naming,
            "enumerations": enumerations,
            "fmi": fmi,
            "progress": lambda text: show(text, None),
        }
        if model is not None:
            built = build_fmu(model, output or Path(f"{model.name}{suffix}"), **options)
        elif robot is not None:
            # choose effects where the scene leaves them open
            if robot.is_open:
                from flexfmu.cosim.design.effects.choice import resolved

                robot = resolved(robot, show)
            built = build_scene(robot, output=output or Path(f"{robot.name}{suffix}"), **options)
    choice = None if robot is None else choice_summary(robot)
    data = asdict(built) | {"path": str(built.path)} | ({"effect_choice": choice} if choice else {})
    sentences = [] if robot is None or robot.effects.choice is None else [choice_sentence(robot)]
    console.print_result(json, data, *sentences, _where(built))
    return 0


def _where(built: BuiltFmu) -> str:
    """A line on a built FMU."""
    origin = "taken from the cache" if built.cached else "built"
    return (
        f"{built.path}: {origin} in {built.seconds:.2f} s, {built.fmu_bytes / 1000:.0f} kB "
        f"({built.code_bytes / 1000:.0f} kB of generated C), GUID {built.guid}"
    )


def fmus(
    scene: str,
    out: Path | None = None,
    slave: list[str] | None = None,
    platform: list[str] | None = None,
    naming: Naming = "structured",
    fmi: FmiVersion = "2",
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
    robot = console.load_resolved(scene, settings)
    folder = out or console.usual_folder(robot.name, settings) / "fmus"
    with console.progress() as show:
        show("building the FMU of the robot", None)
        system = export_slaves(
            robot, folder, names=slave or None, platforms=platform or None, naming=naming, fmi=fmi, progress=show
        )
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
    data = {"slaves": slaves, "connections": connections, "step": system.step, "stop_time": system.stop_time}
    connected = f"connections between them: {len(connections)}, listed by --json"
    console.print_result(json, data, _table(system), f"{folder}: {len(slaves)} FMUs; {connected}")
    return 0


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

    robot = console.load_resolved(scene, settings)
    target = output or Path(f"{robot.name}.ssp")
    with console.progress() as show:
        export_ssp(robot, target, platforms=platform or None, progress=show)
    if robot.cosimulation.drive == "torque":
        _note_late_samples(load_ssp(target).system)
    size = target.stat().st_size
    text = f"{target}: {size / 1000:.0f} kB, SSP 1.0; run it with: flexfmu run {target}"
    console.print_result(json, {"path": str(target), "bytes": size}, text)
    return 0


def _note_late_samples(system: System) -> None:
    """Say which samples other masters pass on a sample late: outputs that follow inputs at once, to slaves that sample
    at the same instants. What they are is in docs/ssp.md."""
    from flexfmu.cosim.engine.slave import Sampled, feedthrough, offset

    # sample time and offset in ns
    clocks = {
        index: (round(1e9 * slave.sample_time), round(1e9 * offset(slave)))
        for index, slave in enumerate(system.slaves)
        if isinstance(slave, Sampled) and slave.sample_time < inf
    }
    # connections with direct feedthrough between slaves whose clocks meet: their offsets differ by common parts of the sample times
    late: dict[str, None] = {}
    for each in system.connections:
        source = system.slaves[each.source]
        if feedthrough(source)[source.variables[each.output].name] and {each.source, each.target} <= clocks.keys():
            (time, begin), (other_time, other_begin) = clocks[each.source], clocks[each.target]
            if (begin - other_begin) % gcd(time, other_time) == 0:
                late[f"{source.name} -> {system.slaves[each.target].name}"] = None
    if late:
        console.show_note(
            f"note: {', '.join(late)} sample at the same instants: masters that read all outputs before they set inputs "
            "(libcosim, ecos, Maestro, fmpy) pass these signals on a sample late; give what is fed an `offset` of a "
            "communication step (docs/ssp.md)"
        )


def validate(
    fmu: Annotated[Path, typer.Argument(readable=False)],
    static: bool = False,
    strict: bool = False,
    time_limit: Annotated[float | None, typer.Option(min=1.0)] = None,
    sandbox: bool = False,
    json: bool = False,
) -> int:
    """Check any FMU 2.0 or 3.0: archive, description, binaries, sources, and a test of each capability that it claims.

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

    if sandbox:
        from flexfmu.cosim.cli.sandbox import run_in_sandbox

        run_in_sandbox(None)
    limit, broken = time_limit or TIME_LIMIT, None
    try:
        with console.progress() as show:
            show(f"checking {fmu.name}, at most {limit:g} s", None)
            findings = validate_fmu(fmu, limit, not static)
    except ArchiveError as error:
        # a file that is no archive is an error here, in JSON a finding too
        findings, broken = [Finding(str(error), check="archive")], error
    data = {"fmu": str(fmu), "time_limit": limit, "findings": [asdict(finding) for finding in findings]}
    if json or broken is None:
        console.print_result(json, data, *(map(str, findings) if findings else [f"{fmu}: no findings"]))
    if broken is not None:
        raise FmuFileError(str(broken)) from broken
    fatal = {Severity.ERROR, Severity.WARNING} if strict else {Severity.ERROR}
    return console.FAILURE if any(finding.severity in fatal for finding in findings) else 0


def wrap(fmu: Annotated[Path, typer.Argument(readable=False)], output: Path | None = None, json: bool = False) -> int:
    """Make an FMU for co-simulation from one of FMI 2.0 for model exchange, with its library and an integrator in it, for this machine.

    Args:
        fmu (FILE.fmu): The FMU for model exchange.
        output (--output, -o FILE.fmu): Default: the name of the FMU with _cs, here.
    """
    from flexfmu.cosim.exchange.wrap import wrap_fmu

    target = output or Path(f"{fmu.stem}_cs.fmu")
    wrap_fmu(fmu, target)
    console.print_result(json, {"fmu": str(target)}, f"{target}: co-simulates {fmu.name}")
    return 0


def cache(clear: bool = False, json: bool = False) -> int:
    """Show where built FMUs, compiled libraries and matrices are kept, and what they take.

    The variable FLEXFMU_CACHE names another folder, FLEXFMU_CACHE_LIMIT the most that it takes in MB, 1000 by default: what was used
    longest ago is removed first.

    Args:
        clear: Remove all of it; what is needed again is built again. Default: keep it.
    """
    from flexfmu.fmu_build.cache import cache_folder, cache_limit, cached_files, remove_cached

    found, limit = cached_files(), cache_limit()
    if clear:
        for each in found:
            remove_cached(each)
    size = sum(each.size for each in found)
    data = {"folder": str(cache_folder()), "files": len(found), "bytes": size, "limit": limit, "cleared": clear}
    taken = f"{len(found)} files, {1e-6 * size:.3g} MB"
    text = f"{taken} removed" if clear else f"{taken} of at most {1e-6 * limit:.4g} MB"
    console.print_result(json, data, f"{data['folder']}: {text}")
    return 0
