"""Programs in C that tests build: what one has compiled, others take."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), "")


def run(*command: object, seconds: float = 600.0) -> str:
    """Standard output of a command that must succeed in time."""
    words = [str(word) for word in command]
    outcome = subprocess.run(words, capture_output=True, text=True, check=False, timeout=seconds)
    assert outcome.returncode == 0, f"{words[0]}: {outcome.returncode} {outcome.stdout}{outcome.stderr[-4000:]}"
    return outcome.stdout


def object_files(folder: Path, sources: Iterable[Path], *flags: str) -> list[Path]:
    """Object files of C sources, compiled side by side in ``folder``; tests share those whose preprocessed text and flags for the compiler
    alone are equal."""

    def compile_one(source: Path) -> Path:
        text = run(COMPILER, *flags, "-E", "-P", source)
        options = [flag for flag in flags if not flag.startswith(("-I", "-D"))]
        name = hashlib.sha256("\0".join([COMPILER, *options, text]).encode()).hexdigest()
        kept = Path(os.environ["FLEXFMU_CACHE"]) / "test-objects" / f"{name}.o"
        if not kept.exists():
            kept.parent.mkdir(parents=True, exist_ok=True)
            fresh = kept.with_suffix(f".{os.getpid()}.{source.stem}")
            run(COMPILER, *flags, "-c", source, "-o", fresh)
            fresh.replace(kept)
        return Path(shutil.copy(kept, folder / f"{source.stem}.o"))

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(compile_one, sources))


def program(folder: Path, objects: Iterable[Path], *flags: str) -> Path:
    """The program of those object files."""
    run(COMPILER, *flags, *objects, "-lm", "-o", folder / "program")
    return folder / "program"
