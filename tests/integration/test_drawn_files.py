"""Files as strangers send them: our own ones with bytes and tokens changed, read by every reader.

`make fuzz` draws 100 000 of them; FLEXFMU_FUZZ sets another number. A reader that fails is shown the fewest changes with which it does.
"""

from __future__ import annotations

import io
import os
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import Phase, given, seed, settings
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.engine.fmu.file import _unpacked, open_fmu
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.xml import read_structure
from flexfmu.cosim.studies.compare.measured import read_log
from flexfmu.cosim.studies.sweep.cases import read_cases
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.scene.file import load_scene, shipped_scenes
from flexfmu.trajectories.table_file import read_signal, read_table

FILES = int(os.environ.get("FLEXFMU_FUZZ", "600"))
"""Number of drawn files of all kinds."""

BATCH = 50
"""Number of files of one kind between two looks at the memory."""

GROWTH = 30e6
"""What the process may grow by from the second half of the batches on [bytes]: pages that the allocator keeps."""

LONGEST = 1000
"""Largest number of characters of an error."""

EXAMPLES = Path(__file__).parents[2] / "examples"

TOKEN = re.compile(rb"[A-Za-z_][\w.]*|[-+]?[\d.]+(?:e[-+]?\d+)?|\s+|.", re.DOTALL)

HOSTILE = (
    *(b"", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b'"', b"'", b"=", b"[", b"{", b"}", b"<", b"/>", b"&#0;", b"&lol;", b"\n", b"\r"),
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e-320", b"true", b"[]", b"{}", b"0x7fffffffffffffff", b"99999999999"),
    *(b"9" * 5000, b"[" * 3000, b"a." * 500, b"x" * 300, b"../../x", b"/dev/zero", b"=1+1", "ü\u202e\U0001f600".encode()),
)
"""Tokens that readers of numbers, names, nested values and paths have to refuse in a sentence."""


def scenes() -> Iterator[bytes]:
    """Scenes with all sections that ship or are examples."""
    for name in shipped_scenes():
        yield (Path(flexfmu.model.scene.file.__file__).parent / "scenes" / f"{name}.toml").read_bytes()
    for path in sorted(EXAMPLES.glob("*.toml")):
        yield path.read_bytes()


def tables() -> Iterator[bytes]:
    """Signals, a motion, cases of a sweep, a log with units and semicolons."""
    yield b"".join(b"%d.5e-3,%d,%d.25\n" % (i, i * i, -i) if i else b'"time","a.b","c[1]"\n' for i in range(12))
    yield b'"time","state"\n0.0,"on"\n0.1,"off"\n'
    yield b"time [s];q1 [rad];q2 [rad]\n" + b"".join(b"%d,5;0,1;-%d\n" % (i, i) for i in range(8))
    yield b"# motion\ntime,x,y,vx,vy\n" + b"".join(b"0.%d,0.%d,0.3,1,0\n" % (i, i) for i in range(8))
    yield b"payload.mass [kg],trajectory.duration [s]\n1,0.4\n2,\n"


def matrices() -> Iterator[bytes]:
    """MAT files by `Recording.write` and by others."""
    import numpy as np
    from scipy.io import savemat

    for content in ({"time": np.arange(5.0), "a": np.ones(5)}, {"time": np.arange(3.0), "s": {"b": [1, "c"]}}):
        for compressed in (False, True):
            file = io.BytesIO()
            savemat(file, content, do_compression=compressed)
            yield file.getvalue()


def described(name: str, content: bytes, path: Path) -> Path:
    """A zip archive with this file alone."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, content)
    return path


def write(content: bytes, path: Path) -> Path:
    """The file as it is."""
    path.write_bytes(content)
    return path


def opened(path: Path) -> None:
    """Unpack and parse an FMU, and forget it."""
    try:
        open_fmu(path)
    finally:
        for folder, _ in _unpacked.values():
            for file in folder.iterdir():
                file.unlink()
            folder.rmdir()
        _unpacked.clear()
