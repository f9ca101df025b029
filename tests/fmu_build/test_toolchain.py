"""Finding and running the C compiler."""

from __future__ import annotations

import ctypes
import platform
import sys
from pathlib import Path

import pytest

from flexfmu.fmu_build import toolchain
from flexfmu.fmu_build.c_header import structures
from flexfmu.fmu_build.errors import CompileError, MissingCompilerError, PlatformError
from flexfmu.fmu_build.toolchain import PLATFORMS, CompileJob, find_compiler, find_platforms, native_platform
from flexfmu.fmu_build.validation.binaries import read_elf


def _build(folder: Path, code: str, flags: tuple[str, ...] = ()) -> Path:
    (folder / "answer.c").write_text(code)
    compiler = find_compiler(native_platform())
    compiler.compile([CompileJob("answer.c", flags)], folder)
    compiler.link(["answer.o"], "answer.so", folder)
    return folder / "answer.so"


def test_nothing_is_exported_by_accident(tmp_path: Path) -> None:
    """The compiler that is found makes libraries that load here; two FMUs in one process must not see each other's functions."""
    visible = '__attribute__((visibility("default"))) int answer(void) { return 42; } int hidden(void) { return 1; }'
    library = _build(tmp_path, visible)
    assert ctypes.CDLL(str(library)).answer() == 42
    assert read_elf(library.read_bytes())[0] == {"answer"}


def test_structures_are_as_the_compiler_lays_them_out(tmp_path: Path) -> None:
    """Python fills structures of C by what it reads in the headers: size and every offset must be those of C."""
    root, found, lines = Path(__file__).parents[2], {}, ["#include <stddef.h>"]
    for name in ("engine/master/c-master/master.h", "engine/master/c-master/dense.h"):
        found |= structures((root / "cosim" / name).read_text(encoding="utf-8"))
        lines.append(f'#include "{root}/cosim/{name}"')
    runtime = root / "fmu_build" / "c-runtime"
    for header in (
        root / "cosim/metrics/c-metrics/metrics.h",
        runtime / "batch/batch.h",
        runtime / "import/exchange.h",
    ):
        found |= structures(header.read_text(encoding="utf-8"))
        lines.append(f'#include "{header}"')
    numbers = {f"sizeof({name})": ctypes.sizeof(each) for name, each in found.items()}
    numbers |= {f"offsetof({n}, {f})": getattr(each, f).offset for n, each in found.items() for f, _ in each._fields_}
    assert len(numbers) > 80
    lines.append(f"const size_t wrong[] = {{{', '.join(f'{name} != {value}' for name, value in numbers.items())}}};")
    lines.append('__attribute__((visibility("default"))) int answer(void) {')
    lines.append(
        "  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) if (wrong[i]) return 1 + (int)i;\n  return 0;\n}"
    )
    assert ctypes.CDLL(str(_build(tmp_path, "\n".join(lines), (f"-I{runtime / 'base'}",)))).answer() == 0


def test_errors_of_the_compiler_are_one_line_with_the_place(tmp_path: Path) -> None:
    """The first error of compiler or linker is what a person needs; a page of output is not."""
    with pytest.raises(CompileError, match=r"compiling answer\.c with .* failed: answer\.c:1:.*error") as caught:
        _build(tmp_path, "int answer(void) { return 42 }")
    assert "\n" not in str(caught.value)
    with pytest.raises(CompileError, match=r"linking answer\.so"):
        find_compiler(native_platform()).link(["none.o"], "answer.so", tmp_path)


def test_cc_variable_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    """CC chooses the compiler, with arguments if it has some; object files of one aren't taken for those of another."""
    monkeypatch.setenv("CC", "gcc")
    first = find_compiler(native_platform()).identity()
    monkeypatch.setenv("CC", "gcc -m64")
    assert find_compiler(native_platform()).command == ("gcc", "-m64")
    assert find_compiler(native_platform()).identity() != first


def test_foreign_platform_needs_zig(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cross compilation without zig says what to install."""
    monkeypatch.setattr(toolchain.importlib.util, "find_spec", lambda name: None)
    foreign = next(target for target in PLATFORMS.values() if target != native_platform())
    with pytest.raises(MissingCompilerError, match=rf"for {foreign.name} on .*pip install flexfmu\[zig\]"):
        find_compiler(foreign)


def test_platforms_are_those_asked_for() -> None:
    """The same set of platforms is the same FMU, however it is asked for; a typing error is answered with the choice."""
    assert find_platforms(["win64", "linux64", "win64"]) == find_platforms(["linux64", "win64"])
    tuples = {each.folder("3") for each in PLATFORMS.values()}
    assert tuples == {f"{one}-{other}" for one in ("x86_64", "aarch64") for other in ("linux", "darwin")} | {
        "x86_64-windows"
    }
    with pytest.raises(PlatformError, match=f"unknown platform 'linux'; choose from {', '.join(PLATFORMS)}"):
        find_platforms(["linux"])


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
    """An importer in this process must be able to load what is built by default, on ARM too; asked for by name, linux64 is x86 and
    aarch64-linux is ARM on every machine. A machine without a name in FMI 2.0 is refused."""
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    (native,) = find_platforms(None)
    assert (native.name, native.zig_target) == (name, zig_target)
    targets = {target.name: target.zig_target.split("-")[0] for target in find_platforms(["linux64", "aarch64-linux"])}
    assert targets == {"linux64": "x86_64", "aarch64-linux": "aarch64"}
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(PlatformError, match=f"no platform for {system} on riscv64"):
        find_platforms(None)
