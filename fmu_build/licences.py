"""Who made what is inside an FMU, and under which terms it may be passed on."""

from __future__ import annotations

import re
from importlib.resources import files

from flexfmu.fmu_build.templating import render

AUTHOR = "the flexfmu authors"
LICENSE = "BSD-3-Clause, see documentation/licenses"

_HEADERS = ("fmi2TypesPlatform.h", "fmi2FunctionTypes.h", "fmi2Functions.h")
"""Files of the FMI standard that FMUs bring along."""

_CASADI = """Of the files model_*.c in the folder sources/ that CasADi (https://casadi.org) has generated.

CasADi's copyright holders claim no ownership of generated code; what comes from CasADi's own templates is under the
MIT No Attribution licence (https://github.com/casadi/casadi/issues/3015).
"""


def licence_files() -> dict[str, str]:
    """The folder ``documentation/licenses/``: path below the FMU's root → text."""
    return {
        "documentation/licenses/license.txt": render("license.txt"),
        "documentation/licenses/fmi-headers.txt": _header_licence(),
        "documentation/licenses/casadi-generated.txt": _CASADI,
    }


def copyright_line() -> str:
    """Who holds the copyright, as the licence says it."""
    return next(line for line in render("license.txt").splitlines() if line.startswith("Copyright"))


def _header_licence() -> str:
    """The licence of the FMI standard's headers, word for word as the first of them carries it."""
    header = (files("flexfmu.fmu_build") / "c-runtime" / _HEADERS[0]).read_text(encoding="utf-8")
    found = re.search(r"^[ ]*Copyright.*?^[ ]*-{20,}.*?^[ ]*-{20,}", header, re.MULTILINE | re.DOTALL)
    text = found.group() if found else header
    return f"Of the FMI standard: {', '.join(_HEADERS)} in the folder sources/.\n\n{text}\n"
