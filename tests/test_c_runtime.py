"""The C runtime: compiled without a warning, run as it is and under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import re
import shutil
import sys
from itertools import product
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from object_files import COMPILER, object_files, program, run

from flexfmu.fmu_build.sources import RuntimeKind, c_files, runtime_sources
from flexfmu.fmu_build.toolchain import FmiVersion, fmi_header_folder

RUNTIME = Path(__file__).parents[1] / "fmu_build" / "c-runtime"
TESTS = Path(__file__).parent / "c-runtime"
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fvisibility=hidden", "-ffp-contract=off", "-fPIC")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
PATHS = {path.name: path for path in sorted(RUNTIME.glob("*/*.[ch]"))}
INCLUDES = [f"-I{folder}" for folder in (*sorted(RUNTIME.iterdir()), fmi_header_folder()) if folder.is_dir()]
SOURCES = [PATHS[name] for name in (*c_files(runtime_sources("plant")), "exchange.c")]
KINDS: tuple[RuntimeKind, ...] = ("plant", "block", "trajectory", "batch", "elementary")
VERSIONS: tuple[FmiVersion, ...] = ("2", "3")
NAMES = [
    name for path in sorted(TESTS.glob("test_*.c")) for name in re.findall(r"^TEST\((\w+)\)", path.read_text(), re.M)
]

pytestmark = pytest.mark.skipif(not COMPILER, reason="no C compiler")


def build(folder: Path, *flags: str) -> Path:
    """The test program."""
    return program(
        folder, object_files(folder, [*SOURCES, *sorted(TESTS.glob("*.c"))], *FLAGS, *INCLUDES, *flags), *flags
    )


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("plain"), "-O2")


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("sanitized"), *SANITIZERS)


@pytest.mark.parametrize("name", NAMES)
def test_c(plain: Path, name: str) -> None:
    """Each test in C states beside its source what it protects."""
    run(plain, name)


def written(folder: Path, kind: RuntimeKind, fmi: FmiVersion) -> list[Path]:
    """The C files of the runtime, as an FMU has them."""
    texts = runtime_sources(kind, fmi)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in c_files(texts)]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_files_compile_as_one(kind: RuntimeKind, fmi: FmiVersion, tmp_path: Path) -> None:
    """The build reads many files as one unit: a name that two of them define for themselves would break it."""
    joined = [path.name for path in written(tmp_path, kind, fmi) if not path.name.startswith("lanes_collocation")]
    (tmp_path / "all.c").write_text("".join(f'#include "{name}"\n' for name in joined))
    object_files(tmp_path, [tmp_path / "all.c"], *FLAGS, f"-I{tmp_path}", "-O1")


def test_lists_all_tests(plain: Path) -> None:
    """A test that isn't found here would never run."""
    assert sorted(run(plain).split()) == sorted(NAMES)
    assert len(NAMES) >= 40


@pytest.mark.slow
def test_sanitizers_find_nothing(sanitized: Path) -> None:
    """A read beyond an array or an overflow gives right results on one machine and wrong ones on another."""
    run(sanitized, *NAMES)


@pytest.mark.skipif(shutil.which("size") is None, reason="no size")
def test_has_no_writable_globals(plain: Path, tmp_path: Path) -> None:
    """Several instances in one process, and threads, must not share anything that changes."""
    objects = [plain.with_name(f"{source.stem}.o") for source in SOURCES]
    seen = {source.read_text() for source in SOURCES}
    for kind, fmi in product(KINDS, VERSIONS):
        (folder := tmp_path / f"{kind}{fmi}").mkdir()
        others = [path for path in written(folder, kind, fmi) if path.read_text() not in seen]
        seen |= {path.read_text() for path in others}
        objects += object_files(folder, others, *FLAGS, f"-I{folder}", "-O2")
    lines = run("size", "-A", *objects).splitlines()
    sections = [line.split() for line in lines if line.startswith((".data ", ".bss "))]
    assert len(sections) == 2 * len(objects)
    assert {size for _, size, _ in sections} == {"0"}


@pytest.mark.skipif(shutil.which("nm") is None, reason="no nm")
@pytest.mark.parametrize("fmi", VERSIONS)
def test_exports_the_fmi_functions_only(fmi: FmiVersion, tmp_path: Path) -> None:
    """Two FMUs in one process would otherwise call into each other."""
    library = tmp_path / "library.so"
    objects = object_files(
        tmp_path, [*written(tmp_path, "plant", fmi), TESTS / "models.c"], *FLAGS, f"-I{tmp_path}", "-O1"
    )
    run(COMPILER, "-shared", *objects, "-lm", "-o", library)
    exported = {line.split()[-1] for line in run("nm", "-D", "--defined-only", library).splitlines()}
    functions = {name for name in exported if name.startswith(f"fmi{fmi}")}
    assert exported - functions - {"_init", "_fini", "_edata", "_end", "__bss_start"} == set()
    declared = set(re.findall(r"FullName\((fmi\w+)\)", (fmi_header_folder() / f"fmi{fmi}Functions.h").read_text()))
    assert functions == declared
