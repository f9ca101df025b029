"""`flexfmu build` and `flexfmu validate`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.cli.console import FAILURE, print_text, progress
from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.reports.text import to_json
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.model.choice_text import choice_sentence
from flexfmu.model.scene.file import load_scene

if TYPE_CHECKING:
    from flexfmu.fmu_build.naming import Naming
    from flexfmu.fmu_build.validation.finding import Finding


def naming_convention(word: str) -> Naming:
    """How variables are named, by the word for it.

    Raises:
        InputError: there is no such naming convention.
    """
    from flexfmu.fmu_build.naming import NAMINGS

    if word not in NAMINGS:
        raise InputError(f"unknown naming convention {word!r}; choose from {', '.join(NAMINGS)}")
    return NAMINGS[word]


def build_command(
    source: str, output: Path | None, platforms: list[str], naming: str, enumerations: bool, as_json: bool
) -> int:
    """Build the scene's FMU and print where it is; the exit status.

    Raises:
        InputError: there is no such naming convention.
    """
    from flexfmu.cosim.experiment.scene_build import build_scene
    from flexfmu.cosim.reports.summary import choice_summary

    # choose effects where the scene leaves them open, then build
    convention = naming_convention(naming)
    scene = load_scene(source)
    target = output or Path(f"{scene.name}.fmu")
    with progress() as show:
        if scene.effects.select is not None:
            from flexfmu.cosim.choices.effects.choice import resolved

            scene = resolved(scene, show)
        built = build_scene(
            scene,
            output=target,
            platforms=platforms or None,
            naming=convention,
            enumerations=enumerations,
            progress=lambda text: show(text, None),
        )
    # standard output
    if as_json:
        choice = choice_summary(scene)
        chosen = {"effect_choice": choice} if choice else {}
        print_text(to_json(asdict(built) | {"path": str(built.path)} | chosen))
        return 0
    if scene.effects.choice is not None:
        print_text(f"{choice_sentence(scene)}\n")
    origin = "taken from the cache" if built.cached else "built"
    print_text(
        f"{built.path}: {origin} in {built.seconds:.2f} s, {built.fmu_bytes / 1000:.0f} kB "
        f"({built.code_bytes / 1000:.0f} kB of generated C), GUID {built.guid}\n"
    )
    return 0


def validate_command(fmu: Path, as_json: bool, time_limit: float | None, run: bool, strict: bool) -> int:
    """Check an FMU and print the findings, one a line; the exit status: 1 if there is an error, or a warning where strict.

    Raises:
        FmuFileError: there is no FMU at this path; with ``as_json`` a finding says so too.
    """
    from flexfmu.fmu_build.validation.finding import Finding, Severity
    from flexfmu.fmu_build.validation.validate import TIME_LIMIT, validate_fmu

    limit = time_limit or TIME_LIMIT
    try:
        with progress() as show:
            show(f"checking {fmu.name}, at most {limit:g} s", None)
            findings = validate_fmu(fmu, limit, run)
    except ArchiveError as error:
        if as_json:
            print_text(_as_json(fmu, limit, [Finding("archive", str(error))]))
        raise FmuFileError(str(error)) from error
    if as_json:
        print_text(_as_json(fmu, limit, findings))
    elif findings:
        print_text("".join(f"{finding}\n" for finding in findings))
    else:
        print_text(f"{fmu}: no findings\n")
    fatal = {Severity.ERROR, Severity.WARNING} if strict else {Severity.ERROR}
    return FAILURE if any(finding.severity in fatal for finding in findings) else 0


def _as_json(fmu: Path, limit: float, findings: list[Finding]) -> str:
    return to_json({"fmu": str(fmu), "time_limit": limit, "findings": [asdict(finding) for finding in findings]})
