"""Validation finds nothing in a sound FMU and names what is wrong with a broken one."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from flexfmu.fmu_build.archive import pack
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.platforms import native_platform
from flexfmu.fmu_build.sources import Sources, generate_sources
from flexfmu.fmu_build.toolchain import RUNTIME_FLAGS, find_compiler
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.symbolic import SymbolicModel

MakeModel = Callable[..., SymbolicModel]
Change = Callable[[dict[str, bytes]], None]

LIBRARY = f"binaries/{native_platform().name}/oscillators{native_platform().suffix}"


@pytest.fixture
def sources(make_oscillators: MakeModel) -> Sources:
    """Sources of the oscillators with a short default experiment."""
    return generate_sources(make_oscillators(static_start=False), DefaultExperiment(stop_time=0.05, step=1e-3))


@pytest.fixture
def broken(sources: Sources, tmp_path: Path) -> Callable[[Change], Path]:
    """Function that writes the oscillators' FMU after a change of its files."""

    def write(change: Change) -> Path:
        library = compile_library(sources, find_compiler(native_platform()))
        files = sources.archive_files() | {LIBRARY: library}
        change(files)
        path = tmp_path / "broken.fmu"
        path.write_bytes(pack(files))
        return path

    return write


def _recompiled(sources: Sources, tmp_path: Path, file: str, code: str) -> Path:
    """FMU with one generated file replaced."""
    changed = replace(sources, generated=sources.generated | {file: code})
    library = compile_library(changed, find_compiler(native_platform()))
    path = tmp_path / "changed.fmu"
    path.write_bytes(pack(changed.archive_files() | {LIBRARY: library}))
    return path


def _findings(path: Path) -> str:
    return "\n".join(str(finding) for finding in validate_fmu(path))


@pytest.mark.slow
@pytest.mark.parametrize("model", ["make_oscillators", "make_lever"])
def test_sound_fmu_has_no_findings(
    model: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What this package builds passes its own checks and fmpy's, also where it is named as users do, from its folder."""
    make: MakeModel = request.getfixturevalue(model)
    build_fmu(make(), stop_time=0.1, output=tmp_path / "sound.fmu")
    monkeypatch.chdir(tmp_path)
    assert validate_fmu(Path("sound.fmu")) == []


def test_empty_guid_is_found(broken: Callable[[Change], Path]) -> None:
    """Without a GUID nothing ties description and binary together."""

    def blank(files: dict[str, bytes]) -> None:
        files["modelDescription.xml"] = re.sub(rb'guid="[^"]*"', b'guid=""', files["modelDescription.xml"])

    assert "guid: the attribute guid is empty" in _findings(broken(blank))


def test_foreign_guid_is_found(broken: Callable[[Change], Path]) -> None:
    """A description of another build does not fit the binary."""

    def exchange(files: dict[str, bytes]) -> None:
        files["modelDescription.xml"] = re.sub(rb'guid="[^"]*"', b'guid="{1}"', files["modelDescription.xml"])

    assert "instantiation: fmi2Instantiate returns no instance" in _findings(broken(exchange))


def test_start_outside_its_range_is_found(broken: Callable[[Change], Path]) -> None:
    """A start beyond min and max would be refused at run time."""

    def exceed(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"]
        files["modelDescription.xml"] = text.replace(b'start="800.0"', b'start="-800.0"')

    assert "start value: stiffness starts at -800.0, outside 0.0 to inf" in _findings(broken(exceed))


def test_missing_binary_is_found(broken: Callable[[Change], Path]) -> None:
    """An FMU without a binary for this machine cannot run here; the finding says what was looked for."""
    assert f"binary: {LIBRARY} is missing" in _findings(broken(lambda files: files.pop(LIBRARY) and None))


def test_misnamed_binary_is_found(broken: Callable[[Change], Path]) -> None:
    """The file name must be the model identifier; the finding names what is there instead."""

    def rename(files: dict[str, bytes]) -> None:
        files[LIBRARY.replace("oscillators", "other")] = files.pop(LIBRARY)

    assert "/other" in _findings(broken(rename))


@pytest.mark.skipif(native_platform().name != "linux64", reason="reads ELF")
def test_binary_of_another_kind_is_found(broken: Callable[[Change], Path]) -> None:
    """A text file under the library's name is no library."""
    assert "not a 64-bit ELF file" in _findings(broken(lambda files: files.update({LIBRARY: b"MZ"})))


@pytest.mark.slow
@pytest.mark.skipif(native_platform().name != "linux64", reason="reads ELF")
def test_visible_internals_are_found(sources: Sources, tmp_path: Path) -> None:
    """Symbols besides the FMI functions collide with those of other FMUs."""
    flags = (*RUNTIME_FLAGS, "-fvisibility=default")
    library = compile_library(sources, find_compiler(native_platform()), runtime_flags=flags)
    path = tmp_path / "visible.fmu"
    path.write_bytes(pack(sources.archive_files() | {LIBRARY: library}))
    assert "besides the FMI functions" in _findings(path)


def test_invalid_description_is_found(broken: Callable[[Change], Path]) -> None:
    """What fmpy's validation says is passed on, one line each."""

    def misspell(files: dict[str, bytes]) -> None:
        files["modelDescription.xml"] = files["modelDescription.xml"].replace(b"<Outputs>", b"<Outptus>")

    findings = validate_fmu(broken(misspell))
    assert {finding.check for finding in findings} == {"model description"}
    assert all("\n" not in finding.message for finding in findings)


FORGETFUL = """
#include "model_functions.h"
int model_outputs(const double **arg, double **res, int *iw, double *w, int mem) {
  static double calls = 0.0;
  for (int i = 0; i < 8; i++) res[0][i] = calls;
  calls += 1.0;
  return 0;
}
"""
ENDLESS = FORGETFUL.replace("res[0][i] = calls", "res[0][i] = 1.0 / (calls - calls)")
DEADLY = FORGETFUL.replace("calls += 1.0", "__builtin_trap()")


@pytest.mark.slow
def test_hidden_state_is_found(sources: Sources, tmp_path: Path) -> None:
    """Memory outside the instance shows after a reset, in saved states and between instances."""
    findings = validate_fmu(_recompiled(sources, tmp_path, "model_outputs.c", FORGETFUL))
    assert {finding.check for finding in findings} >= {"reset", "state", "serialisation", "instances"}


def test_infinite_output_is_found(sources: Sources, tmp_path: Path) -> None:
    """An output that is no number is named with its time, whether the FMU refuses it or hands it out."""
    assert "simulation:" in _findings(_recompiled(sources, tmp_path, "model_outputs.c", ENDLESS))


@pytest.mark.slow
def test_crash_is_a_finding(sources: Sources, tmp_path: Path) -> None:
    """An FMU that kills its process does not kill the validation."""
    assert "ended with signal" in _findings(_recompiled(sources, tmp_path, "model_outputs.c", DEADLY))


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_file_that_is_no_archive_is_an_error(tmp_path: Path, content: bytes) -> None:
    """A wrong file is told from a broken FMU."""
    path = tmp_path / "x.fmu"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match="no intact FMU"):
        validate_fmu(path)


def test_truncated_archive_is_an_error(make_oscillators: MakeModel, tmp_path: Path) -> None:
    """Half a download is an error with the remedy."""
    content = build_fmu(make_oscillators()).path.read_bytes()
    path = tmp_path / "x.fmu"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(ArchiveError, match="build it again"):
        validate_fmu(path)


def test_archive_without_description_is_an_error(tmp_path: Path) -> None:
    """Any other zip file is no FMU."""
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "")
    with pytest.raises(ArchiveError, match=r"modelDescription\.xml is missing"):
        validate_fmu(path)


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    """A wrong path says how to get an FMU."""
    with pytest.raises(ArchiveError, match="flexfmu build"):
        validate_fmu(tmp_path / "none.fmu")
