"""Mutants of a sound FMU, and which of them flexfmu, fmpy, VDMCheck2 and fmutool find, as a table.

    python benchmarks/validators.py

It needs what the tests need: `pip install --group test`, and `.ci/tools` for VDMCheck2. A tool that isn't there is left out.
"""

from __future__ import annotations

import io
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu as validate_by_fmpy

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fmu_build" / "validation"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "third_party"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "cosim" / "exchange" / "fmu_export"))

from mutants import DESCRIPTION, MUTANTS, Mutant, compile_spring, sound_variants, spring_files
from test_checkers import fmutool, vdmcheck

from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.validation.validate import validate_fmu

PARTS = ("archive", "description", "behaviour")


def by_flexfmu(mutants: dict[str, Path]) -> set[str]:
    """Names of those in which flexfmu finds something."""
    found = set()
    for name, path in mutants.items():
        try:
            if validate_fmu(path, 10.0 if name in ("hang", "pending_forever") else 60.0):
                found.add(name)
        except ArchiveError:
            found.add(name)
    return found


def one_by_one(tool: Callable[[Path], object]) -> Callable[[dict[str, Path]], set[str]]:
    """The same for a tool that takes an FMU and returns what it finds; an exception is a finding too."""

    def find(mutants: dict[str, Path]) -> set[str]:
        found = set()
        for name, path in mutants.items():
            try:
                with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                    findings = tool(path)
            except pytest.skip.Exception:
                raise
            except BaseException:  # whatever a tool makes of a broken FMU, SystemExit among it
                findings = True
            if findings:
                found.add(name)
        return found

    return find


def by_vdmcheck(mutants: dict[str, Path]) -> set[str]:
    """The same for VDMCheck2, which looks at descriptions; a file without one is found."""
    found: set[str] = set()
    named: dict[bytes, list[str]] = {}
    for name, path in mutants.items():
        try:
            with zipfile.ZipFile(path) as archive:
                named.setdefault(archive.read(DESCRIPTION), []).append(name)
        except (zipfile.BadZipFile, KeyError, OSError, zlib.error):
            found.add(name)
    folder = next(iter(mutants.values())).parent
    paths = {str(folder / f"{number}.xml"): content for number, content in enumerate(named)}
    for path, content in paths.items():
        Path(path).write_bytes(content)
    for line in vdmcheck("rules", [Path(path) for path in paths], folder):
        found.update(named[paths[line.split("\t")[0]]])
    return found


TOOLS: dict[str, Callable[[dict[str, Path]], set[str]]] = {
    "flexfmu": by_flexfmu,
    "fmpy": one_by_one(lambda path: validate_by_fmpy(str(path))),
    "VDMCheck2": by_vdmcheck,
    "fmutool": one_by_one(fmutool),
}


def main() -> None:
    """Write the mutants, let each tool look, and print."""
    with tempfile.TemporaryDirectory() as folder:
        library = compile_spring(Path(folder))
        sound = spring_files(library)
        paths: dict[str, Path] = {}
        for number, mutant in enumerate([*MUTANTS, Mutant("sound", "", lambda _: sound_variants(library)["sound"])]):
            paths[mutant.name] = Path(folder) / f"{number}.fmu"
            paths[mutant.name].write_bytes(mutant.make(sound))
        print("".join(word.ljust(15) for word in ("tool", *PARTS, "all", "sound FMU")).rstrip())
        missed = {}
        for tool, find in TOOLS.items():
            try:
                found = find(paths)
            except pytest.skip.Exception as reason:
                print(f"{tool}: left out, {reason}")
                continue
            groups = [[each.name for each in MUTANTS if part in (each.part, "all")] for part in (*PARTS, "all")]
            cells = [f"{len(found & set(names))} of {len(names)}" for names in groups]
            cells.append("found wanting" if "sound" in found else "no findings")
            print("".join(cell.ljust(15) for cell in (tool, *cells)).rstrip(), flush=True)
            missed[tool] = [each.name for each in MUTANTS if each.name not in found]
    print(f"missed by flexfmu: {', '.join(missed['flexfmu']) or 'none'}")


if __name__ == "__main__":
    main()
