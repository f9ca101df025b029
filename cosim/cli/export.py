"""`flexfmu export`: a scene as one SSP file."""

from __future__ import annotations

from math import gcd, lcm
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from flexfmu.cosim.cli.console import load_resolved, print_text, progress, show_note
from flexfmu.cosim.cli.options import JsonOption, PlatformOption, SceneArgument, SetOption, option
from flexfmu.cosim.reports.text import to_json

if TYPE_CHECKING:
    from fractions import Fraction

    from flexfmu.cosim.engine.master.system import System


def export(
    scene: SceneArgument,
    output: Annotated[Path | None, option("FILE.ssp", "Default: the scene's name, here.", "--output", "-o")] = None,
    platform: PlatformOption = None,
    settings: SetOption = None,
    json: JsonOption = False,
) -> int:
    """Write a whole scene as one SSP 1.0 file: its FMUs, their connections and parameters.

    Other tools simulate the file as it is; here: flexfmu run FILE.ssp.
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
