"""Object files that tests share: what one has compiled, others take."""

from __future__ import annotations

import hashlib
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path


def compiled(command: Sequence[object], source: Path) -> bytes:
    """Object file of a C source; tests share those whose preprocessed text and command, apart from folders, are equal.

    Args:
        command: compiler with all its flags but source and output.
        source: C file.
    """
    words = [str(word) for word in command]
    text = _run([*words, "-E", "-P", str(source)])
    options = [word for word in words if not word.startswith("-I")]
    name = hashlib.sha256("\0".join([*options, text]).encode()).hexdigest()
    kept = Path(os.environ["FLEXFMU_CACHE"]) / "test-objects" / f"{name}.o"
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        fresh = kept.with_suffix(f".{os.getpid()}.{source.stem}")
        _run([*words, "-c", str(source), "-o", str(fresh)])
        fresh.replace(kept)
    return kept.read_bytes()


def _run(command: list[str]) -> str:
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, f"{command[0]}: {outcome.stdout}{outcome.stderr[-4000:]}"
    return outcome.stdout
