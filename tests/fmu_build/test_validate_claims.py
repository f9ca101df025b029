"""Each check has an FMU that it finds wanting: a sound one, written apart from this package, spoilt in one respect."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import pytest

from flexfmu.fmu_build.archive import pack
from flexfmu.fmu_build.finding import Finding
from flexfmu.fmu_build.platforms import native_platform
from flexfmu.fmu_build.toolchain import find_compiler
from flexfmu.fmu_build.validate import validate_fmu

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(native_platform().name != "linux64", reason="compiles and reads ELF"),
]

SOURCES = Path(__file__).parent / "spring-fmu"
DESCRIPTION = (SOURCES / "modelDescription.xml").read_bytes()
LIBRARY = "binaries/linux64/spring.so"

Spring = Callable[..., dict[str, bytes]]


@pytest.fixture(scope="module")
def spring(tmp_path_factory: pytest.TempPathFactory) -> Spring:
    """Function that compiles the FMU with one macro and any compiler flags; its files."""
    folder = tmp_path_factory.mktemp("spring")
    headers = str(files("flexfmu.fmu_build") / "c-runtime")
    compiler = find_compiler(native_platform()).command

    def make(macro: str = "SOUND", *flags: str) -> dict[str, bytes]:
        library = folder / f"{macro}.so"
        strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-fPIC", "-shared")
        source = str(SOURCES / "spring.c")
        subprocess.run(
            [*compiler, *strict, f"-D{macro}", f"-I{headers}", source, "-o", str(library), *flags], check=True
        )
        return {"modelDescription.xml": DESCRIPTION, LIBRARY: library.read_bytes()}

    return make


def findings(content: dict[str, bytes], folder: Path, timeout: float = 60.0) -> list[Finding]:
    """What validation finds in an FMU of these files."""
    path = folder / "spring.fmu"
    path.write_bytes(pack(content))
    return validate_fmu(path, timeout)


def checks(content: dict[str, bytes], folder: Path, timeout: float = 60.0) -> set[str]:
    """Names of the checks that find something."""
    return {finding.check for finding in findings(content, folder, timeout)}


def test_sound_foreign_fmu_has_no_findings(spring: Spring, tmp_path: Path) -> None:
    """Whatever is found in the spoilt ones is due to what was spoilt."""
    assert findings(spring(), tmp_path) == []


@pytest.mark.parametrize(
    ("macro", "check"),
    [
        ("BREAK_VERSION", "instantiation"),
        ("BREAK_EXIT", "instantiation"),
        ("BREAK_GUID", "guid"),
        ("BREAK_URI_SLASHES", "resource location"),
        ("BREAK_URI_PERCENT", "resource location"),
        ("BREAK_NAN", "simulation"),
        ("BREAK_MEMORY", "memory"),
        ("BREAK_RESET", "reset"),
        ("BREAK_STATE", "state"),
        ("BREAK_SERIALISATION", "serialisation"),
        ("BREAK_INSTANCES", "instances"),
        ("BREAK_STEP", "variable step"),
        ("BREAK_INPUT_DERIVATIVES", "input derivatives"),
        ("BREAK_OUTPUT_DERIVATIVES", "output derivatives"),
        ("BREAK_DIRECTIONAL", "directional derivatives"),
        ("BREAK_DERIVATIVES", "derivatives"),
        ("BREAK_INTERFACES", "interfaces"),
        ("BREAK_EXPORTS", "binary"),
        ("BREAK_VISIBILITY", "binary"),
    ],
)
def test_false_claim_is_found(spring: Spring, tmp_path: Path, macro: str, check: str) -> None:
    """What an FMU claims and does not do is found by the check for it."""
    assert check in checks(spring(macro), tmp_path)


def test_crash_does_not_hide_the_rest(spring: Spring, tmp_path: Path) -> None:
    """After a crash the next check goes on in a new process: each one that crashes is named."""
    found = findings(spring("BREAK_CRASH"), tmp_path)
    assert {"simulation", "reset", "state", "instances"} <= {finding.check for finding in found}
    assert any("ended with signal 6" in finding.message for finding in found)


def test_endless_call_ends(spring: Spring, tmp_path: Path) -> None:
    """An FMU that never returns costs no more than the time limit, and what was not checked is said."""
    found = [str(finding) for finding in findings(spring("BREAK_HANG"), tmp_path, timeout=4.0)]
    assert any("did not finish within" in finding for finding in found)
    assert any(finding.startswith("note: simulation: ") and "not checked" in finding for finding in found)


def test_unusual_dependencies_are_found(spring: Spring, tmp_path: Path) -> None:
    """A library that needs others, or looks for them in a folder of the machine it was built on, loads there alone."""
    content = spring("SOUND", "-Wl,--no-as-needed", "-lstdc++", "-Wl,-rpath,/opt/mine")
    text = "\n".join(map(str, findings(content, tmp_path)))
    assert "dependencies: binaries/linux64/spring.so needs libstdc++.so.6" in text
    assert "looks for libraries in /opt/mine" in text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b'min="-1" max="1" start="0"', b'min="1" max="-1" start="0"', "min 1 above max -1"),
        (b'min="-1" max="1" start="0"', b'min="-1" max="1" start="2"', "starts at 2.0, outside -1.0 to 1.0"),
        (b'start="0.1"', b'start="NaN"', "starts at nan"),
        (b'start="0.1"', b'nominal="0" start="0.1"', "nominal 0"),
        (b'guid="{spring}"', b'guid=""', "guid is empty"),
    ],
)
def test_contradiction_in_the_description_is_found(
    spring: Spring, tmp_path: Path, old: bytes, new: bytes, message: str
) -> None:
    """What no schema forbids, and what it does."""
    content = {"modelDescription.xml": DESCRIPTION.replace(old, new)}
    assert message in "\n".join(map(str, findings(content, tmp_path)))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("documentation/other.html", "no index.html"),
        ("../outside.txt", "leaves the folder"),
        ("resources\\table.csv", "has a backslash"),
        ("binaries/linux/spring.so", "no tool looks into binaries/linux/"),
        ("binaries/win64/other.dll", "binaries/win64/spring.dll is missing, win64/ has binaries/win64/other.dll"),
    ],
)
def test_misplaced_file_is_found(tmp_path: Path, name: str, message: str) -> None:
    """Files where no tool looks for them, or where none should be."""
    content = {"modelDescription.xml": DESCRIPTION, name: b"x"}
    assert message in "\n".join(map(str, findings(content, tmp_path)))


def test_missing_source_is_found(tmp_path: Path) -> None:
    """An FMU that lists sources must have them, or it can't be built again."""
    build = b'<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="spring"><SourceFileSet>'
    build += b'<SourceFile name="lost.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>'
    content = {"modelDescription.xml": DESCRIPTION, "sources/buildDescription.xml": build}
    assert "sources/lost.c is listed but missing" in "\n".join(map(str, findings(content, tmp_path)))
