"""`flexfmu build`: the FMU of a scene."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from flexfmu.cosim.cli.console import load_changed, print_text, progress
from flexfmu.cosim.cli.options import (
    JsonOption,
    NamingOption,
    PlatformOption,
    SceneArgument,
    SetOption,
    flag,
    naming_convention,
    option,
)
from flexfmu.cosim.reports.text import to_json


def build(
    scene: SceneArgument,
    output: Annotated[Path | None, option("FILE.fmu", "Default: the scene's name, here.", "--output", "-o")] = None,
    platform: PlatformOption = None,
    naming: NamingOption = "structured",
    enumerations: Annotated[
        bool,
        flag(
            "Make initial and integrator FMI enumerations. Default: Integers, since Maestro refuses them.",
            "--enumerations",
        ),
    ] = False,
    settings: SetOption = None,
    json: JsonOption = False,
) -> int:
    """Build the FMI 2.0 FMU of a scene, for co-simulation and model exchange."""
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
