"""Files as strangers send them: our own ones with bytes and tokens changed, read by every reader.

`make fuzz` draws 100 000 for each of the readers, 10^6 in all; FLEXFMU_FUZZ sets another number. A reader that fails is shown the fewest changes with which it does.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import Phase, given, seed, settings
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.measured import read_log
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.export import export_ssp
from flexfmu.cosim.exchange.ssp.structure import read_structure
from flexfmu.cosim.studies.sweep.cases import read_cases
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.scene.file import load_scene, shipped_scenes
from flexfmu.trajectories.table import read_signal, read_table

FILES = int(os.environ.get("FLEXFMU_FUZZ", "60"))
"""Number of drawn files of each kind."""

BATCH = 50
"""Number of files of one kind between two looks at the memory."""

GROWTH = 30e6
"""What the process may grow by from the second half of the batches on [bytes]: pages that the allocator keeps."""

EXAMPLES = Path(__file__).parents[2] / "examples"

TOKEN = re.compile(rb"[A-Za-z_][\w.]*|[-+]?[\d.]+(?:e[-+]?\d+)?|\s+|.", re.DOTALL)

HOSTILE = (
    b"", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b'"', b"'", b"=", b"[", b"{", b"}", b"<", b"/>", b"&#0;", b"&lol;", b"\n", b"\r",
    b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e-320", b"true", b"[]", b"{}", b"0x7fffffffffffffff", b"99999999999",
    b"9" * 5000, b"[" * 3000, b"a." * 500, b"x" * 300, b"../../x", b"/dev/zero", b"=1+1", "ü\u202e\U0001f600".encode(),
)  # fmt: skip
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


@cache
def exported() -> dict[str, bytes]:
    """The SSD of a scene and the description of its robot."""
    with TemporaryDirectory() as folder:
        path = export_ssp(load_scene("barnard2012-6kg"), Path(folder) / "a.ssp")
        with zipfile.ZipFile(path) as archive:
            fmu = max(archive.infolist(), key=lambda entry: entry.file_size)
            with zipfile.ZipFile(io.BytesIO(archive.read(fmu))) as robot:
                description = robot.read("modelDescription.xml")
            return {"structure": archive.read("SystemStructure.ssd"), "description": description}


def descriptions() -> Iterator[bytes]:
    """Of a robot, and of other tools' FMUs."""
    yield exported()["description"]
    for path in sorted((Path(__file__).parents[1] / "cosim" / "engine" / "foreign-fmu").glob("*.xml")):
        yield path.read_bytes()


def structures() -> Iterator[bytes]:
    """Of a scene with units, parameters and connections."""
    yield exported()["structure"]


def described(name: str, content: bytes, path: Path) -> Path:
    """A zip archive with this file alone."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, content)
    return path


def write(content: bytes, path: Path) -> Path:
    """The file as it is."""
    path.write_bytes(content)
    return path


READERS: dict[str, tuple[Callable[[], Iterator[bytes]], Callable[[bytes, Path], object]]] = {
    "scene": (scenes, lambda content, folder: load_scene(write(content, folder / "a.toml"))),
    "signals": (tables, lambda content, folder: Recording.read(write(content, folder / "a.csv"))),
    "log": (tables, lambda content, folder: read_log(write(content, folder / "a.csv"), {}, {"q1": "rad", "a.b": "m"})),
    "motion": (tables, lambda content, folder: read_table(write(content, folder / "a.csv"))),
    "signal": (tables, lambda content, folder: read_signal(write(content, folder / "a.csv"), "x", "")),
    "cases": (tables, lambda content, folder: read_cases(write(content, folder / "a.csv"))),
    "matrices": (matrices, lambda content, folder: Recording.read(write(content, folder / "a.mat"))),
    "description": (
        descriptions,
        lambda content, folder: open_fmu(described("modelDescription.xml", content, folder / "a.fmu")),
    ),
    "validation": (
        descriptions,
        lambda content, folder: validate_fmu(described("modelDescription.xml", content, folder / "a.fmu"), run=False),
    ),
    "structure": (
        structures,
        lambda content, folder: read_structure(SspArchive(described("SystemStructure.ssd", content, folder / "a.ssp"))),
    ),
}
"""Reader → its corpus, and how it reads a file."""


@st.composite
def changed(draw: st.DrawFn, corpus: list[bytes]) -> bytes:
    """One of the files with one to four changes of bytes or tokens."""
    content = draw(st.sampled_from(corpus))
    for _ in range(draw(st.integers(1, 4))):
        if draw(st.booleans()):  # a token becomes a hostile one, goes, or stands twice
            tokens = TOKEN.findall(content) or [b""]
            place = draw(st.integers(0, len(tokens) - 1))
            tokens[place] = draw(st.sampled_from([*HOSTILE, tokens[place] * 2, tokens[place - 1]]))
            content = b"".join(tokens)
        else:  # bytes go, come, or turn over
            begin = draw(st.integers(0, len(content)))
            end = min(len(content), begin + draw(st.sampled_from([0, 1, 1, 2, 8, 100, 10**9])))
            content = content[:begin] + draw(st.binary(max_size=4)) + content[end:]
    return content


def memory() -> float:
    """Memory of this process [bytes]; zero where it isn't known."""
    status = Path("/proc/self/statm")
    return 4096.0 * int(status.read_text().split()[1]) if status.exists() else 0.0


@pytest.mark.filterwarnings("ignore:Generating overly large repr")  # of a file that is refused in a wrong way
@pytest.mark.parametrize("kind", READERS)
def test_a_file_is_read_or_refused_in_a_sentence(kind: str, tmp_path: Path) -> None:
    """Whatever it holds: no exception but the house's own, and nothing stays in memory."""
    corpus, read = list(READERS[kind][0]()), READERS[kind][1]
    batches = max(1, FILES // BATCH)
    before = memory()

    def holds(content: bytes) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(flexfmu.Error):
                read(content, tmp_path)

    for number in range(batches):
        if number == batches // 2:
            before = memory()
        strict = settings(max_examples=BATCH, database=None, derandomize=False, phases=[Phase.generate, Phase.shrink])
        seed(number)(strict(given(changed(corpus))(holds)))()
    if batches >= 20:
        assert memory() - before < GROWTH
