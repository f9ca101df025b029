"""Finding and running the C compiler."""

from __future__ import annotations

import ctypes
import importlib.util
import platform
import sys
from pathlib import Path

import pytest

from flexfmu.fmu_build import toolchain
from flexfmu.fmu_build.errors import CompileError, MissingCompilerError, PlatformError
from flexfmu.fmu_build.toolchain import PLATFORMS, CompileJob, find_compiler, find_platforms, native_platform
from flexfmu.fmu_build.validation.binaries import read_elf

HAS_ZIG = importlib.util.find_spec("ziglang") is not None


@pytest.fixture
def without_zig(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if ziglang were not installed."""
    monkeypatch.setattr(toolchain.importlib.util, "find_spec", lambda name: None)


def _build(folder: Path, code: str, flags: tuple[str, ...] = ()) -> Path:
    (folder / "answer.c").write_text(code)
    compiler = find_compiler(native_platform())
    compiler.compile([CompileJob("answer.c", flags)], folder)
    compiler.link(["answer.o"], "answer.so", folder)
    return folder / "answer.so"


def test_compiled_code_runs(tmp_path: Path) -> None:
    """The compiler that is found makes libraries that load here."""
    library = _build(tmp_path, '__attribute__((visibility("default"))) int answer(void) { return 42; }')
    assert ctypes.CDLL(str(library)).answer() == 42


def test_nothing_is_exported_by_accident(tmp_path: Path) -> None:
    """Two FMUs in one process must not see each other's functions."""
    library = _build(tmp_path, "int hidden; int answer(void) { return 42; }")
    assert read_elf(library.read_bytes()).exports == set()


def test_compiler_error_is_one_line_with_the_place(tmp_path: Path) -> None:
    """The first error of the compiler is what a person needs; a page of output is not."""
    with pytest.raises(CompileError, match=r"compiling answer\.c with .* failed: answer\.c:1:.*error") as caught:
        _build(tmp_path, "int answer(void) { return 42 }")
    assert "\n" not in str(caught.value)


def test_linker_error_is_one_line(tmp_path: Path) -> None:
    """A missing object is the linker's error, not a traceback."""
    with pytest.raises(CompileError, match=r"linking answer\.so"):
        find_compiler(native_platform()).link(["none.o"], "answer.so", tmp_path)


def test_cc_variable_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    """CC chooses the compiler, with arguments if it has some; object files of one aren't taken for those of another."""
    monkeypatch.setenv("CC", "gcc")
    first = find_compiler(native_platform()).identity()
    monkeypatch.setenv("CC", "gcc -m64")
    assert find_compiler(native_platform()).command == ("gcc", "-m64")
    assert find_compiler(native_platform()).identity() != first


@pytest.mark.usefixtures("without_zig")
def test_foreign_platform_needs_zig(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cross compilation without zig says what to install."""
    foreign = next(target for target in PLATFORMS.values() if target != native_platform())
    with pytest.raises(MissingCompilerError, match=rf"for {foreign.name} on .*pip install flexfmu\[zig\]"):
        find_compiler(foreign)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_ZIG, reason="needs ziglang")
def test_zig_is_the_last_resort(monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler from PyPI serves where the system has none."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert "ziglang" in find_compiler(native_platform()).command


def test_unknown_platform_lists_the_known_ones() -> None:
    """A typing error in --platform is answered with the choice."""
    with pytest.raises(
        PlatformError,
        match="unknown platform 'linux'; choose from linux64, win64, darwin64, aarch64-linux, aarch64-darwin",
    ):
        find_platforms(["linux"])


def test_platforms_are_sorted_and_unique() -> None:
    """The same set of platforms is the same FMU, however it is asked for."""
    assert find_platforms(["win64", "linux64", "win64"]) == find_platforms(["linux64", "win64"])
    assert find_platforms(None) == (native_platform(),)


@pytest.mark.parametrize(
    ("system", "machine", "name", "zig_target"),
    [
        ("linux", "x86_64", "linux64", "x86_64-linux-gnu.2.17"),
        ("linux", "aarch64", "linux64", "aarch64-linux-gnu.2.17"),
        ("win32", "AMD64", "win64", "x86_64-windows-gnu"),
        ("darwin", "arm64", "darwin64", "aarch64-macos.11.0"),
    ],
)
def test_native_platform_fits_the_interpreter(
    monkeypatch: pytest.MonkeyPatch, system: str, machine: str, name: str, zig_target: str
) -> None:
    """An importer in this process must be able to load what is built by default, on ARM too."""
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    (native,) = find_platforms(None)
    assert (native.name, native.zig_target) == (name, zig_target)


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_names_mean_what_the_standard_says(monkeypatch: pytest.MonkeyPatch, machine: str) -> None:
    """Asked for by name, linux64 is x86 and aarch64-linux is ARM on every machine: one build line, one FMU."""
    monkeypatch.setattr(platform, "machine", lambda: machine)
    targets = {target.name: target.zig_target.split("-")[0] for target in find_platforms(["linux64", "aarch64-linux"])}
    assert targets == {"linux64": "x86_64", "aarch64-linux": "aarch64"}


def test_machine_without_a_name_in_fmi_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """FMI 2.0 ends here, and says so."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(PlatformError, match="no platform for linux on riscv64"):
        find_platforms(None)
