"""The C of blocks and trajectories: without a warning, under the sanitizers, without anything that instances share."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from export_support.blocks import pd_controller, quantiser
from export_support.trajectories import Swing

from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import Sources, c_files, generate_sources
from flexfmu.fmu_build.trajectory_build import Motion

DRIVER = Path(__file__).parent / "c" / "drive.c"
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
FLAGS = ("-std=c99", "-fvisibility=hidden", "-ffp-contract=off", "-fPIC")
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wno-sign-conversion", "-Werror")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
EXPERIMENT = DefaultExperiment()

SOURCES: dict[str, tuple[Callable[[], Sources], int, int]] = {
    "block": (lambda: generate_sources(pd_controller(), EXPERIMENT), 6, 2),
    "stateless block": (lambda: generate_sources(quantiser(), EXPERIMENT), 2, 1),
    "trajectory": (
        lambda: generate_sources(Motion(Swing(), ["axis"], "m"), EXPERIMENT),  # type: ignore[arg-type]
        3,
        0,
    ),
}
"""What is compiled → sources, number of Real variables, and of inputs among them."""

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


def run(*command: object) -> str:
    """Standard output of a command that must succeed."""
    outcome = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, f"{command[0]}: {outcome.stdout}{outcome.stderr}"
    return outcome.stdout


def compile_all(folder: Path, sources: Sources, flags: tuple[str, ...]) -> list[Path]:
    """Object files; hand-written files and constant tables without a warning, CasADi's functions as they are."""
    texts = sources.generated | sources.runtime
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")

    def compile_one(name: str) -> Path:
        target = folder / name.replace(".c", ".o")
        warnings = ("-w",) if name == "model_sample.c" else STRICT
        run(COMPILER, *FLAGS, *warnings, *flags, "-c", folder / name, "-o", target)
        return target

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(compile_one, c_files(texts)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", SOURCES)
def test_sanitizers_find_nothing_in_a_whole_life(kind: str, tmp_path: Path) -> None:
    """A read beyond an array gives right results on one machine and a crash on another."""
    make, reals, inputs = SOURCES[kind]
    sources = make()
    objects = compile_all(tmp_path, sources, SANITIZERS)
    defines = (f'-DGUID="{sources.guid}"', f"-DN_REALS={reals}", f"-DN_INPUTS={inputs}")
    program = tmp_path / "drive"
    run(
        COMPILER,
        *FLAGS,
        *SANITIZERS,
        *defines,
        "-Wno-type-limits",
        f"-I{tmp_path}",
        DRIVER,
        *objects,
        "-lm",
        "-o",
        program,
    )
    run(program)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("size") is None, reason="no size")
@pytest.mark.parametrize("kind", SOURCES)
def test_nothing_is_shared_between_instances(kind: str, tmp_path: Path) -> None:
    """No writable globals: several instances and threads live side by side."""
    objects = compile_all(tmp_path, SOURCES[kind][0](), ("-O2",))
    sections = [line.split() for line in run("size", "-A", *objects).splitlines()]
    assert {line[1] for line in sections if line and line[0] in (".data", ".bss")} == {"0"}


def test_each_kind_has_its_own_runtime() -> None:
    """An FMU carries the sources that it is built from, and no integrator where nothing is integrated."""
    block, trajectory = (set(SOURCES[kind][0]().runtime) for kind in ("block", "trajectory"))
    assert "block.c" in block
    assert "inputs.c" in block
    assert "trajectory.c" in trajectory
    assert not {name for name in block | trajectory if name.startswith(("integrator", "plant", "stages", "linear"))}
    assert not {name for name in trajectory if name.startswith(("block", "inputs"))}
