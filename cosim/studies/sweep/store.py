"""Where the results of a sweep are kept: in memory, or in a folder, case by case.

While a sweep runs, each finished case is a line of ``journal.csv``, which is only appended to: whatever ends the process, at most
a line that is being written is torn, and the next run cuts it off. At the end the lines, in the order of the cases, become
``sweep.csv``: the same bytes whatever was interrupted, and by however many processes.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import OutputFolder, write_pieces
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.studies.sweep.cases import Cases
from flexfmu.cosim.studies.sweep.manifest import difference, read_manifest
from flexfmu.cosim.studies.sweep.work import Row

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

MANIFEST, JOURNAL, TABLE, SIGNALS = "sweep.json", "journal.csv", "sweep.csv", "signals"
"""What is swept, finished cases while the sweep runs, all of them at its end, and the folder of recorded signals."""

LINES = 1024
"""Number of lines that are written at once."""


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
        OutputFolder(folder).prepare()
        self._lock = _locked(folder)
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
            (self.folder / JOURNAL).unlink(missing_ok=True)
        else:
            self._file = open(self.folder / JOURNAL, "ab+", buffering=0)  # noqa: SIM115 - closed by `close`
            self._recover()

    def _recover(self) -> None:
        """Find the finished cases, and cut off a line that was being written."""
        self._file.seek(0)
        end = 0
        with os.fdopen(os.dup(self._file.fileno()), "rb") as journal:
            for place, line in enumerate(journal):
                if not line.endswith(b"\n"):
                    break
                if place:
                    self._offsets[self._number(line)] = end
                end += len(line)
        self._file.truncate(end)
        self._end = end
        self.done = int((self._offsets >= 0).sum())
        if not end:
            self._append(self._head)

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
        place = self._end
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
        self._append("".join(lines))

    def _append(self, text: str) -> None:
        """Append whole lines.

        Raises:
            ResultsError: the disk is full, for example.
        """
        data = memoryview(text.encode())
        self._end += len(data)
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            raise ResultsError(f"can't write {self.folder / JOURNAL}: {error.strerror or error}") from error

    def finish(self) -> None:
        """Write the table in the order of the cases, and remove the journal."""
        if self.is_complete:
            return
        write_pieces(self.folder / TABLE, self._sorted())
        self.is_complete = True
        self._file.close()
        (self.folder / JOURNAL).unlink()

    def _sorted(self) -> Iterator[str]:
        """Yield the lines of the journal in the order of the cases."""
        yield self._head
        with open(self.folder / JOURNAL, "rb") as journal:
            for offset in self._offsets.tolist():
                journal.seek(offset)
                yield journal.readline().decode()

    def close(self) -> None:
        """Let other processes into the folder."""
        with contextlib.suppress(AttributeError):
            self._file.close()
        if self._lock is not None:
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


def _locked(folder: Path) -> Any:
    """The folder's lock file, held until it is closed; None where files can't be locked.

    Raises:
        ResultsError: another process holds it.
    """
    if fcntl is None:
        return None
    file = open(folder / ".lock", "a")  # noqa: SIM115 - held until the end
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # not inherited by the workers
    except (BlockingIOError, PermissionError):
        file.close()
        raise ResultsError(f"another sweep works in {folder}: wait for its end, or choose another --out") from None
    except OSError:
        file.close()
        return None
    return file
