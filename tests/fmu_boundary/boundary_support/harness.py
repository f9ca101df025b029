"""Programs of an FMU's sources and a test in C."""

from __future__ import annotations

import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from object_files import compiled

from boundary_support.subjects import Subject

C_TESTS = Path(__file__).parents[1] / "c"
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-type-limits")  # zero inputs make comparisons trivial
ADDRESS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
COMMON = ("importer.c",)


def run(*command: object, seconds: float = 600.0, **environment: str) -> str:
    """Standard output of a command that must succeed in time."""
    words = [str(word) for word in command]
    outcome = subprocess.run(
        words, capture_output=True, text=True, check=False, timeout=seconds, env={**os.environ, **environment}
    )
    assert outcome.returncode == 0, f"{words[0]}: {outcome.returncode} {outcome.stdout}{outcome.stderr[-4000:]}"
    return outcome.stdout


def has_sanitizer(name: str, folder: Path) -> bool:
    """Whether the compiler can build and start a program under that sanitizer."""
    source, program = folder / f"{name}.c", folder / name
    source.write_text("int main(void) { return 0; }\n")
    command = [COMPILER or "cc", f"-fsanitize={name}", source, "-o", program]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        return False
    return subprocess.run([program], capture_output=True, check=False).returncode == 0


def build(folder: Path, subject: Subject, tests: tuple[str, ...], flags: tuple[str, ...]) -> Path:
    """The program; hand-written files compile without a warning."""
    for name, text in (subject.own | subject.generated).items():
        (folder / name).write_text(text, encoding="utf-8")
    own = [folder / name for name in subject.own if name.endswith(".c")]
    generated = [folder / name for name in subject.generated if name.endswith(".c")]
    jobs = [(path, STRICT) for path in (*own, *(C_TESTS / name for name in (*COMMON, *tests)))]
    jobs += [(path, ("-w",)) for path in generated]

    def compile_one(job: tuple[Path, tuple[str, ...]]) -> Path:
        source, warnings = job
        target = folder / f"{source.stem}.o"
        options = ("-std=c99", "-ffp-contract=off", *flags, *warnings, *subject.defines)
        command = (COMPILER, *options, f"-I{folder}", f"-I{C_TESTS}")
        target.write_bytes(compiled(command, source))
        return target

    with ThreadPoolExecutor(2) as pool:
        objects = list(pool.map(compile_one, jobs))
    program = folder / "program"
    run(COMPILER, *flags, *objects, "-lm", "-o", program)
    return program
