"""From model to file: reproducible, cached by content, with one-line errors."""

from __future__ import annotations

import errno
import stat
import tempfile
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from flexfmu.fmu_build import build, cache, compilation, toolchain
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import ArchiveError, CacheWarning, MissingCompilerError, PlatformError
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.sources import Sources
from flexfmu.fmu_build.toolchain import native_platform
from flexfmu.model.symbolic import FUNCTION_SIGNATURES, SymbolicModel

MakeModel = Callable[..., SymbolicModel]


def _never() -> SymbolicModel:
    raise AssertionError("the model must not be made")


def _no_space(*arguments: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """FMUs whose library is a text: without object files from the cache the runtime takes seconds to compile."""
    monkeypatch.setattr(build, "compile_library", lambda *arguments, **options: b"library")


def _library(path: Path) -> bytes:
    with zipfile.ZipFile(path) as archive:
        target = native_platform()
        return archive.read(f"binaries/{target.name}/oscillators{target.suffix}")


@pytest.mark.slow
def test_two_builds_are_equal_byte_for_byte(
    make_oscillators: MakeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither time, folder nor cache shows in the file."""
    with_shared_objects = build_fmu(make_oscillators(), output=tmp_path / "one.fmu").path.read_bytes()
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "empty"))
    assert build_fmu(make_oscillators(), output=tmp_path / "two.fmu").path.read_bytes() == with_shared_objects


def test_file_has_all_its_parts(make_oscillators: MakeModel) -> None:
    """Description, binary with the same GUID, the sources that it came from, documentation and licence."""
    built = build_fmu(make_oscillators())
    assert built.guid.encode() in _library(built.path)
    with zipfile.ZipFile(built.path) as archive:
        assert {"modelDescription.xml", "sources/model_description.c", "sources/model.h"} <= {*archive.namelist()}
        assert {"documentation/index.html", "documentation/licenses/license.txt"} <= {*archive.namelist()}


def test_guid_follows_the_content(make_oscillators: MakeModel) -> None:
    """Whatever changes the behaviour changes the GUID; the same content keeps it."""
    experiment = build.DefaultExperiment()
    guids = [
        generate_sources(make_oscillators(), experiment).guid,
        generate_sources(make_oscillators(mass=3.0), experiment).guid,
        generate_sources(make_oscillators(static_start=False), experiment).guid,
        generate_sources(make_oscillators(), build.DefaultExperiment(tolerance=1e-8)).guid,
    ]
    assert len(set(guids)) == 4
    assert generate_sources(make_oscillators(), experiment).guid == guids[0]


def test_cached_build_makes_no_model(make_oscillators: MakeModel, tmp_path: Path) -> None:
    """With a key the decision needs neither CasADi nor a compiler, and has nothing to tell; `-o` gets the file all the same. A model
    without a key is recognised by its generated C."""
    told: list[str] = []
    first = build_fmu(make_oscillators, key="oscillators", progress=told.append)
    second = build_fmu(_never, key="oscillators", progress=told.append, output=tmp_path / "out" / "robot.fmu")
    assert told == ["building the model", "generating C", f"compiling for {native_platform().name}", "packing"]
    assert (first.cached, second.cached) == (False, True)
    assert (first.guid, first.code_bytes) == (second.guid, second.code_bytes)
    assert second.path.read_bytes() == first.path.read_bytes()
    assert stat.S_IMODE(second.path.stat().st_mode) == 0o644
    assert [build_fmu(make_oscillators(mass=mass)).cached for mass in (3.0, 3.0, 4.0)] == [False, True, False]


@pytest.mark.usefixtures("uncompiled")
@pytest.mark.parametrize("change", [{"tolerance": 1e-9}, {"stop_time": 2.0}, {"step": 1e-3}, {"cache": False}])
def test_other_settings_are_another_build(
    make_oscillators: MakeModel, change: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default experiment belongs to the content; `cache=False` builds anew, as does another version of the package."""
    build_fmu(make_oscillators, key="oscillators")
    assert not build_fmu(make_oscillators, key="oscillators", **change).cached  # type: ignore[arg-type]
    monkeypatch.setattr(build, "package_fingerprint", lambda: "another")
    assert not build_fmu(make_oscillators, key="oscillators").cached


def test_another_compiler_is_another_build(make_oscillators: MakeModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever names a compiler gets its FMU, or its error, never what another compiler once built."""
    monkeypatch.setenv("CC", "cc")
    assert not build_fmu(make_oscillators, key="oscillators").cached
    assert build_fmu(_never, key="oscillators").cached
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(MissingCompilerError, match="'no-such-compiler' of the variable CC"):
        build_fmu(_never, key="oscillators")


def test_damaged_cache_entry_is_built_again(make_oscillators: MakeModel) -> None:
    """A crashed disk or a curious person does not break anything."""
    first = build_fmu(make_oscillators, key="oscillators")
    intact = first.path.read_bytes()
    flipped = bytearray(intact)
    flipped[len(intact) // 2] ^= 255
    first.path.write_bytes(flipped)
    second = build_fmu(make_oscillators, key="oscillators")
    assert (second.cached, second.path.read_bytes()) == (False, intact)


def test_concurrent_builds_agree(make_oscillators: MakeModel) -> None:
    """Several processes or threads may build the same FMU at once."""
    with ThreadPoolExecutor(4) as pool:
        built = list(pool.map(lambda _: build_fmu(make_oscillators, key="oscillators"), range(4)))
    assert len({(b.path, b.guid) for b in built}) == 1
    assert zipfile.ZipFile(built[0].path).testzip() is None


@pytest.mark.usefixtures("uncompiled")
def test_useless_cache_folder_is_said_once(
    make_oscillators: MakeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read-only home directory is no reason to refuse a build, but it costs time: what, where and the remedy are said. Where not even
    a temporary folder takes the FMU, the error names the variable."""
    (tmp_path / "file").write_text("")
    useless, output = tmp_path / "file" / "cache", tmp_path / "robot.fmu"
    monkeypatch.setenv("FLEXFMU_CACHE", str(useless))
    with pytest.warns(CacheWarning, match=f"{useless} .Not a directory.*FLEXFMU_CACHE") as warned:
        assert build_fmu(make_oscillators(), key="oscillators", output=output).path.is_file()
    assert len(warned) == 1
    again = build_fmu(_never, key="oscillators")
    assert again.cached
    assert again.path.read_bytes() == output.read_bytes()

    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "file"))
    monkeypatch.setattr(cache, "temporary_folder", _no_space)
    with pytest.raises(ArchiveError, match=r"file/\w+\.fmu: .*FLEXFMU_CACHE"):
        build_fmu(make_oscillators(mass=3.0))
    assert build_fmu(make_oscillators(mass=3.0), output=output).path.is_file()


def test_what_is_missing_is_found_out_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for a model that cannot be compiled; a typing error costs no time either."""
    with pytest.raises(PlatformError, match="unknown platform 'amiga'"):
        build_fmu(_never, key="oscillators", platforms=["amiga"])
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(toolchain.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingCompilerError, match=r"install gcc or clang, or run: pip install flexfmu\[zig\]"):
        build_fmu(_never, key="oscillators")


def test_full_temporary_folder_is_an_error(
    make_oscillators: MakeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A compiler without room for its files gives one sentence with the way out."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(ArchiveError, match="TMPDIR"):
        build_fmu(make_oscillators(), output=tmp_path / "robot.fmu")


@pytest.mark.parametrize("changed", ["part.c", "part.h"])
def test_a_changed_part_compiles_again_what_includes_it(changed: str) -> None:
    """After an update of the package no file keeps what it once included."""
    compiler = toolchain.find_compiler(native_platform())

    def library(texts: dict[str, str]) -> bytes:
        return compile_library(Sources("parts", "", "", {}, texts, {}), compiler)

    exported = '__attribute__((visibility("default"))) double number(void) { return PART + part; }'
    whole = f'#include "part.h"\n#include "part.c"\n{exported}\n'
    texts = {"whole.c": whole, "part.c": "static const double part = 1.25;\n", "part.h": "#define PART 3.5\n"}
    assert library(texts) == library(texts)
    assert library(texts) != library(texts | {changed: texts[changed].replace("5", "7")})


def test_seldom_called_functions_exist() -> None:
    """A function that gets another name is compiled like the others, which takes longer: this says so."""
    assert {*compilation._SELDOM} <= {*FUNCTION_SIGNATURES}
