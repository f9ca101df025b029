"""A short life of an FMU in a process of its own; what it finds goes to a file, line by line, as it is found.

python -m flexfmu.fmu_build.checks.child FILE.fmu REPORT KIND CHECK [CHECK...]
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import asdict
from pathlib import Path

import fmpy
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.checks.catalogue import CHECKS
from flexfmu.fmu_build.checks.fmu import FmuUnderTest, Kind
from flexfmu.fmu_build.checks.life import Check
from flexfmu.fmu_build.finding import Finding

MAXIMUM_STEPS = 300
"""Communication steps that a run has at most."""


def main() -> None:
    """Run the checks that the command line names."""
    path, report, kind, *names = sys.argv[1:]
    folder = Path(fmpy.extract(path))
    (folder / "resources").mkdir(exist_ok=True)
    try:
        fmu = FmuUnderTest(read_model_description(path, validate=False), folder, Kind[kind], MAXIMUM_STEPS)
        with Path(report).open("a", encoding="utf-8", buffering=1) as file:
            for name in names:
                file.write(json.dumps({"begin": name}) + "\n")
                finding = _outcome(name, CHECKS[name], fmu)
                if finding is not None:
                    file.write(json.dumps(asdict(finding)) + "\n")
            file.write(json.dumps({"end": kind}) + "\n")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _outcome(name: str, check: Check, fmu: FmuUnderTest) -> Finding | None:
    try:
        return check(fmu)
    except Exception as error:  # any failed FMI call is a finding, not the end of the validation
        logged = f" ({fmu.messages[-1]})" if fmu.messages else ""
        return Finding(name, " ".join(f"{error}{logged}".split()))
    finally:
        fmu.messages.clear()


if __name__ == "__main__":
    main()
