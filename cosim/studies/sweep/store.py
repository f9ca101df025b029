"""Where the results of a sweep are kept: in memory, or in a folder, case by case, beside what is swept.

While a sweep runs, each finished case is a line of ``journal.csv``. At the end the lines, in the order of the cases, become
``sweep.csv``: the same bytes whatever was interrupted, and by however many processes. A sweep with other scene, cases or metrics
doesn't continue one in a folder.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import write_pieces
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.many.journal import Journal, locked
from flexfmu.cosim.studies.sweep.cases import Cases, Grid, Sample, Span, digest
from flexfmu.cosim.studies.sweep.work import Job, Row
from flexfmu.model.scene.file import file_digests

NAMED = 20
"""Values of a key that the manifest lists; of more it has the ends and a hash."""


def make_manifest(job: Job, units: Mapping[str, str]) -> dict[str, Any]:
    """What is swept: a sweep with another one doesn't continue this one."""
    return {
        "flexfmu": version("flexfmu"),
        "scene": job.scene.model_dump(mode="json", exclude_none=True),
        **({"files": files} if (files := file_digests(job.scene)) else {}),
        "cases": _described(job.cases),
        "metrics": list(job.metrics.names),
        "record": None if job.record is None else {"signals": list(job.record.names or ()), "step": job.record.step},
        "units": dict(units),
    }


def _described(cases: Cases) -> dict[str, Any]:
    """The cases for the manifest."""
    found: dict[str, Any] = {"count": len(cases), "keys": list(cases.keys)}
    if isinstance(cases, Grid):
        found["values"] = {key: _listed(level) for key, level in zip(cases.keys, cases.levels, strict=True)}
    if isinstance(cases, Sample):
        found |= {"sample": cases.method, "seed": cases.seed}
        found["values"] = {
            key: f"{each.low!r}:{each.high!r}" if isinstance(each, Span) else _listed(each)
            for key, each in zip(cases.keys, cases.values, strict=True)
        }
    return found | {"hash": digest(cases)}


def _listed(values: Sequence[Any]) -> Any:
    """A list of values, or the ends of a long one."""
    return list(values) if len(values) <= NAMED else f"{len(values)} values from {values[0]!r} to {values[-1]!r}"


def read_manifest(path: Path) -> dict[str, Any] | None:
    """What is swept in a folder; None if nothing is.

    Raises:
        ResultsError: the file can't be read.
    """
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise ResultsError(f"can't read {path}: {error}; use --restart, or another --out") from error
    return found


def difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """What differs between two sweeps, the first few differences."""
    one, two = _flat(before), _flat(after)
    found = [
        f"{key} was {_short(one.get(key))}, now {_short(two.get(key))}"
        for key in {**one, **two}
        if one.get(key) != two.get(key)
    ]
    rest = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return ", ".join(found[:3]) + rest


def _flat(data: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted keys of nested tables → values."""
    if not isinstance(data, Mapping):
        return {prefix: data}
    return {
        key: value
        for name, each in data.items()
        for key, value in _flat(each, f"{prefix}.{name}" if prefix else name).items()
    }


def _short(value: Any) -> str:
    """A value for a message."""
    text = "not there" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


MANIFEST, JOURNAL, TABLE, SIGNALS = "sweep.json", "journal.csv", "sweep.csv", "signals"
"""What is swept, finished cases while the sweep runs, all of them at its end, and the folder of recorded signals."""


def text_of(value: Any) -> str:
    """A value of a scene key as a cell: numbers so that they read back exactly, texts as they are, the rest as JSON."""
    if value is None or isinstance(value, str):
        return value or ""
    return json.dumps(value, ensure_ascii=False)


def signal_file(folder: Path, number: int) -> Path:
    """File of the recorded signals of a case."""
    return folder / SIGNALS / f"{number:06d}.csv"


class MemoryStore:
    """Results in memory.

    Args:
        count: number of cases.
        metrics: number of metrics.

    Attributes:
        values: (N, M) metrics; NaN for none.
        messages: number of a failed case → message.
        recordings: number of a case → its signals.
        done: number of finished cases.
    """

    def __init__(self, count: int, metrics: int) -> None:
        self.values: RealArray = np.full((count, metrics), np.nan)
        self.messages: dict[int, str] = {}
        self.recordings: dict[int, Recording] = {}
        self.done = 0

    def has(self, numbers: Sequence[int]) -> bool:
        """Whether cases are finished: nothing is, before the sweep begins."""
        return False

    def add(self, rows: Iterable[Row]) -> None:
        """Keep results."""
        for row in rows:
            self.values[row.number] = [np.nan if each is None else each for each in row.values]
            if row.message:
                self.messages[row.number] = row.message
            if row.recording is not None:
                self.recordings[row.number] = row.recording
            self.done += 1


class FolderStore:
    """Results in a folder; a context that no other process is in for the same folder.

    Args:
        folder: the folder; created if it doesn't exist.
        cases: of the sweep.
        head: headings of the table: ``case``, keys, metrics, ``message``.
        manifest: what is swept.
        restart: whether the results of another sweep are discarded; otherwise they are an error.

    Attributes:
        folder: the folder.
        is_complete: whether all cases are in the table.
        done: number of finished cases.

    Raises:
        InputError: the folder has results of another sweep.
        ResultsError: the folder can't be written, or another process works in it.
    """

    def __init__(
        self, folder: Path, cases: Cases, head: Sequence[str], manifest: Mapping[str, Any], *, restart: bool = False
    ) -> None:
        self.folder, self._cases, self._head = folder, cases, _line(head)
        self._journal = Journal(folder / JOURNAL)
        try:
            self._lock = locked(folder / ".lock")
        except (BlockingIOError, PermissionError):
            raise ResultsError(f"another sweep works in {folder}: wait for its end, or choose another --out") from None
        try:
            self._begin(json.loads(json.dumps(manifest)), restart)
        except BaseException:
            self.close()
            raise

    def _begin(self, manifest: dict[str, Any], restart: bool) -> None:
        """Compare the sweep with the one in the folder, and read what is finished."""
        before = None if restart else read_manifest(self.folder / MANIFEST)
        if before is not None and before != manifest:
            raise InputError(
                f"{self.folder} has the results of another sweep: {difference(before, manifest)}; choose another --out, or "
                f"discard them with --restart"
            )
        if before is None:
            if not restart and any((self.folder / name).exists() for name in (JOURNAL, TABLE)):
                raise InputError(f"{self.folder} has a {TABLE} without {MANIFEST}: choose another --out, or --restart")
            self._discard()
            text = json.dumps(manifest, ensure_ascii=False, indent=1)
            write_pieces(self.folder / MANIFEST, [text, "\n"])
        # offsets of the finished cases in the journal, or in the table at the end
        self.is_complete = (self.folder / TABLE).exists()
        self._offsets = np.full(len(self._cases), -1, np.int64)
        self.done = len(self._cases)
        if self.is_complete:
            # it may have ended between the table and this
            self._journal.path.unlink(missing_ok=True)
            return
        for number, (offset, line) in enumerate(self._journal.read()):
            if number:
                self._offsets[self._number(line)] = offset
        self.done = int((self._offsets >= 0).sum())
        if not self._journal.size:
            self._journal.append(self._head)

    def _number(self, line: bytes) -> int:
        """The number of the case in a line of the journal.

        Raises:
            ResultsError: it has none.
        """
        first = line.partition(b",")[0]
        if first.isdigit() and int(first) < len(self._cases):
            return int(first)
        raise ResultsError(
            f"{self.folder / JOURNAL} has a line that is no case: {line[:40]!r}; begin anew with --restart"
        )

    def _discard(self) -> None:
        """Remove the results of another sweep."""
        for name in (MANIFEST, JOURNAL, TABLE, "sweep.parquet", "sweep.png", "sweep.svg"):
            (self.folder / name).unlink(missing_ok=True)
        for path in (self.folder / SIGNALS).glob("*.csv"):
            path.unlink()

    def has(self, numbers: Sequence[int]) -> bool:
        """Whether all of these cases are finished."""
        return self.is_complete or all(self._offsets.item(number) >= 0 for number in numbers)

    def add(self, rows: Iterable[Row]) -> None:
        """Write finished cases at once, each as a line."""
        lines: list[str] = []
        place = self._journal.size
        for row in rows:
            if self._offsets[row.number] >= 0:
                continue
            if row.recording is not None:
                row.recording.write_csv(signal_file(self.folder, row.number))
            cells = ["" if each is None else repr(each) for each in row.values]
            keys = [text_of(each) for each in self._cases[row.number]]
            lines.append(_line([str(row.number), *keys, *cells, row.message]))
            self._offsets[row.number] = place
            self.done += 1
            place += len(lines[-1].encode())
        self._journal.append("".join(lines))

    def finish(self) -> None:
        """Write the table in the order of the cases, and remove the journal."""
        if self.is_complete:
            return
        write_pieces(self.folder / TABLE, self._sorted())
        self.is_complete = True
        self._journal.path.unlink()

    def _sorted(self) -> Iterator[str]:
        """Yield the lines of the journal in the order of the cases."""
        yield self._head
        with self._journal.path.open("rb") as journal:
            for offset in self._offsets.tolist():
                journal.seek(offset)
                yield journal.readline().decode()

    def close(self) -> None:
        """Let other processes into the folder."""
        self._lock.close()

    def __enter__(self) -> FolderStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_results(folder: Path, count: int, metrics: int) -> MemoryStore:
    """The results of a finished sweep.

    Raises:
        ResultsError: the table can't be read.
    """
    found = MemoryStore(count, metrics)
    try:
        with open(folder / TABLE, encoding="utf-8", newline="") as file:
            lines = csv.reader(file)
            next(lines)
            for line in lines:
                number = int(line[0])
                found.values[number] = [float(cell) if cell else np.nan for cell in line[-metrics - 1 : -1]]
                if line[-1]:
                    found.messages[number] = line[-1]
    except (OSError, ValueError, IndexError, StopIteration) as error:
        raise ResultsError(f"can't read {folder / TABLE}: {error}; remove it, or use --restart") from error
    return found


def _line(cells: Sequence[str]) -> str:
    """Cells as a line of CSV without line breaks inside."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([" ".join(each.splitlines()) for each in cells])
    return text.getvalue()
