"""`flexfmu validate`: checks of any FMU."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from flexfmu.cosim.cli.console import FAILURE, print_text, progress
from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.cosim.reports.text import to_json
from flexfmu.fmu_build.errors import ArchiveError


def validate(
    fmu: Annotated[Path, typer.Argument(readable=False)],
    static: bool = False,
    strict: bool = False,
    time_limit: Annotated[float | None, typer.Option(min=1.0)] = None,
    json: bool = False,
) -> int:
    """Check any FMU 2.0: archive, description, binaries, and each claim tried for real.

    Of an FMU 3.0 the description alone is checked.

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
