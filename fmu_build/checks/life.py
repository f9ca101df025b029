"""Birth, names and death of an instance."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

import numpy as np

from flexfmu.fmu_build.checks.fmu import FmuUnderTest
from flexfmu.fmu_build.finding import Finding, Severity

Check = Callable[[FmuUnderTest], Finding | None]
"""Tries one thing with an FMU; None if all is well. A failed FMI call may raise."""


def instantiates(fmu: FmuUnderTest) -> Finding | None:
    """An instance can be made, and the binary speaks FMI 2.0; nothing else makes sense without."""
    with fmu.instance("version") as instance:
        version, types = instance.version()
    if (version, types) == ("2.0", "default"):
        return None
    return Finding("instantiation", f"the binary says version {version}, types platform {types}", "say 2.0 and default")


def refuses_wrong_guid(fmu: FmuUnderTest) -> Finding | None:
    """A binary must not run with somebody else's description."""
    with suppress(Exception), fmu.instance("wrong_guid", guid="{00000000-0000-0000-0000-000000000000}"):
        return Finding("guid", "fmi2Instantiate accepts a wrong GUID", "compare it with the one of the description")
    return None


def accepts_odd_uris(fmu: FmuUnderTest) -> Finding | None:
    """The resources may lie anywhere, and RFC 3986 and RFC 8089 allow to say so in several ways."""
    for uri in _uris(fmu.folder):
        problem = _starts_with(fmu, uri)
        if problem is not None:
            shown = uri.replace(str(fmu.folder), "/FOLDER")
            return Finding(
                "resource location", f"with {shown} the FMU fails: {problem}", "decode file URIs as RFC 8089 says"
            )
    with TemporaryDirectory(prefix="with space ") as home:
        folder = shutil.copytree(fmu.folder / "resources", Path(home) / "resources", dirs_exist_ok=True)
        problem = _starts_with(fmu, f"file://{quote(str(folder))}")
    if problem is None:
        return None
    return Finding("resource location", f"with a %20 in the URI the FMU fails: {problem}", "decode percent signs")


def _uris(folder: Path) -> list[str]:
    path = quote(str(folder / "resources"))
    return [f"file:{path}", f"file://{path}", f"file://{path}/", f"file://localhost{path}"]


def _starts_with(fmu: FmuUnderTest, uri: str) -> str | None:
    """What goes wrong up to the first step with this resource location."""
    try:
        with fmu.instance("uri", uri=uri) as instance:
            instance.initialize()
    except Exception as error:  # fmpy's own kinds of errors
        return " ".join(str(error).split())
    return None


def outputs_are_finite(fmu: FmuUnderTest) -> Finding | None:
    """The default experiment gives numbers."""
    with fmu.instance("finite") as instance:
        rows = instance.run()
    bad = np.argwhere(~np.isfinite(rows))
    if not bad.size:
        return None
    row, column = map(int, bad[0])
    names = [variable.name for variable in fmu.outputs]
    which = column - (rows.shape[1] - len(names))
    what = names[which] if which >= 0 else f"derivative {column + 1}"
    return Finding("simulation", f"{what} is {rows[row, column]} at {fmu.start + (row + 1) * fmu.step:.6g} s")


def gives_memory_back(fmu: FmuUnderTest) -> Finding | None:
    """What was allocated through the callbacks is free again when the last instance is."""
    fmu.blocks.clear()
    with fmu.instance("memory") as instance:
        instance.initialize()
        instance.advance(0, min(fmu.steps, 3))
    if not fmu.blocks:
        return None
    return Finding(
        "memory",
        f"fmi2FreeInstance leaves {len(fmu.blocks)} blocks of allocateMemory behind",
        "free them all",
        Severity.WARNING,
    )
