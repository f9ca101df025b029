"""Is this FMU sound? Static checks of description and binary, then a short life of it in another process."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.finding import REPORT, Finding
from flexfmu.fmu_build.static_checks import check_statically

DYNAMIC_TIMEOUT = 300.0
"""Longest wait for the FMU's life in another process [s]; the paper's scene needs less than one."""


def validate_fmu(path: Path) -> list[Finding]:
    """Check an FMU 2.0 for co-simulation; an empty list says that nothing was found.

    Static: archive, `fmpy.validation.validate_fmu`, GUID, start values, binary and its exported functions.
    Dynamic, in a process of its own so that a crash is a finding too: instantiation, refusal of a wrong GUID, the default
    experiment with finite outputs, the same results after a reset, from a saved state and with two instances at once.
    An FMU that fails the static checks of description or binary is not run.

    Raises:
        ArchiveError: the file is missing, no zip archive, damaged, or has no modelDescription.xml.
    """
    files = _read(path)
    findings = check_statically(path, files)
    return findings if findings else _run_apart(path)


def _read(path: Path) -> dict[str, bytes]:
    """Content of the archive, path inside → bytes; every entry is read, so its checksum is checked."""
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise ArchiveError(
            f"no FMU at {path}; build one with: flexfmu build SCENE -o {path.name or 'NAME.fmu'}"
        ) from error
    except OSError as error:
        raise ArchiveError(f"cannot read the FMU {path}: {error.strerror}; check its permissions") from error
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = {entry.filename: archive.read(entry) for entry in archive.infolist() if not entry.is_dir()}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise ArchiveError(f"{path} is no intact FMU (zip archive): {error}; build it again") from error
    if "modelDescription.xml" not in files:
        raise ArchiveError(f"{path} is a zip archive but no FMU: modelDescription.xml is missing")
    return files


def _run_apart(path: Path) -> list[Finding]:
    command = (sys.executable, "-m", "flexfmu.fmu_build.dynamic_checks", str(path))
    try:
        outcome = subprocess.run(command, capture_output=True, text=True, timeout=DYNAMIC_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        return [Finding("simulation", f"the FMU did not finish within {DYNAMIC_TIMEOUT:.0f} s")]
    if outcome.returncode != 0:
        how = f"signal {-outcome.returncode}" if outcome.returncode < 0 else f"exit status {outcome.returncode}"
        last = (outcome.stderr.strip().splitlines() or ["no message"])[-1]
        return [Finding("simulation", f"the process that ran the FMU ended with {how}: {last}")]
    report = next(line for line in reversed(outcome.stdout.splitlines()) if line.startswith(REPORT))
    return [Finding(**finding) for finding in json.loads(report.removeprefix(REPORT))]
