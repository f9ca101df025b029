"""What long work has found, kept at once in a file that is only appended to: whatever ends the process, or the machine, at most a line
that is being written is torn, and the next process cuts it off."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.model.scene.file import file_digests
from flexfmu.model.scene.schema import Scene

Found = TypeVar("Found")


class Journal:
    """A file of lines.

    Args:
        path: of the file; its folder is created if it doesn't exist.
        restart: whether the lines of an earlier process are discarded.

    Attributes:
        path: of the file.
        size: its length [bytes], once it is read.

    Raises:
        ResultsError: the folder or the file can't be written.
    """

    def __init__(self, path: Path, *, restart: bool = False) -> None:
        OutputFolder(path.parent).prepare()
        self.path, self.size = path, 0
        if restart:
            OutputFolder(path.parent).remove(path.name)

    def read(self) -> Iterator[tuple[int, bytes]]:
        """Yield place and content of each whole line, then cut off what is torn.

        Raises:
            ResultsError: the file can't be read or cut.
        """
        self.size = 0
        try:
            with self.path.open("rb+") as file:
                for line in file:
                    if line.endswith(b"\n"):
                        yield self.size, line
                        self.size += len(line)
                file.truncate(self.size)
        except FileNotFoundError:
            return
        except OSError as error:
            raise ResultsError(f"can't read {self.path}: {error.strerror or error}") from error

    def append(self, text: str) -> None:
        """Append whole lines, which are on the disk when this returns.

        Raises:
            ResultsError: the disk is full, for example.
        """
        data = memoryview(text.encode())
        self.size += len(data)
        try:
            with self.path.open("ab", buffering=0) as file:
                while data:
                    data = data[file.write(data) :]
                os.fsync(file.fileno())
        except OSError as error:
            raise ResultsError(f"can't write {self.path}: {error.strerror or error}") from error


FILE = "journal.jsonl"
"""A journal of work: what determines the results in its first line, key and result of a finished unit in each other one."""


class WorkJournal:
    """The finished units of a command's work: the same command takes them from its folder, and makes the others alone.

    Lines are JSON with exact floats, so that a journal from anywhere runs nothing.

    Args:
        folder: where the file is; created if it doesn't exist. None to keep nothing.
        work: what is done, ``tuning`` for example.
        about: what determines the results.
        restart: whether other work in the folder is discarded; otherwise it is an error.
        note: is called with a sentence if there are finished units.
        total: number of all units; None where it isn't known before.

    Attributes:
        done: number of finished units.

    Raises:
        InputError: the folder has other work.
        ResultsError: the folder can't be read or written.
    """

    def __init__(
        self,
        folder: Path | None = None,
        work: str = "",
        about: Mapping[str, Any] | None = None,
        *,
        restart: bool = False,
        note: Callable[[str], object] = lambda text: None,
        total: int | None = None,
    ) -> None:
        self._known, self._lines, self._head, self.done = dict[str, Any](), None, "", 0
        if folder is None:
            return
        self._lines = Journal(folder / FILE, restart=restart)
        head = json.loads(_text({"work": work, "flexfmu": version("flexfmu"), **(about or {})}))
        found = [each for _, line in self._lines.read() if (each := _read(line)) is not None]
        if not found:
            # written with the first result: work that is refused leaves nothing
            self._head = f"{_text(head)}\n"
        elif found[0] != head:
            before = found[0] if isinstance(found[0], dict) else {}
            raise InputError(
                f"{folder} has another {work}: {difference(before, head)}; choose another --out, or discard it with --restart"
            )
        self._known = {each[0]: each[1] for each in found[1:] if isinstance(each, list) and len(each) == 2}
        self.done = len(self._known)
        if self.done:
            note(f"continuing: {self.done} {'' if total is None else f'of {total} '}done")

    def __contains__(self, key: Any) -> bool:
        return _name(key) in self._known

    def kept(self, key: Any, kind: Any, compute: Callable[[], Found]) -> Found:
        """The result of a unit: from the file, or computed and kept.

        Args:
            key: data that tells it from all other units.
            kind: type of the result: plain data, arrays as lists of them, or dataclasses of such.
            compute: the result; what it raises isn't kept.

        Raises:
            ResultsError: the file can't be written, or has something else.
        """
        name = _name(key)
        if name in self._known:
            try:
                there: Found = TypeAdapter(kind).validate_python(self._known[name])
                return there
            except ValidationError:
                place = "the journal" if self._lines is None else self._lines.path
                raise ResultsError(f"{place} has no result of this work: begin anew with --restart") from None
        found = compute()
        if self._lines is not None:
            self._lines.append(f"{self._head}{_text([name, found])}\n")
            self._head, self.done = "", self.done + 1
        return found

    def remove(self) -> None:
        """Remove the file: the work is done, and its results are written."""
        if self._lines is not None:
            OutputFolder(self._lines.path.parent).remove(FILE)


NOWHERE = WorkJournal()
"""Keeps nothing."""


def about_scene(scene: Scene) -> dict[str, Any]:
    """What a scene determines results by: its keys, and the files that it names."""
    keys = {"scene": scene.model_dump(mode="json", exclude_none=True)}
    return keys | ({"files": files} if (files := file_digests(scene)) else {})


def difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """What differs between what two results are of, the first few differences."""

    def flat(data: Any, key: str) -> dict[str, Any]:
        # dotted keys of nested tables
        if not isinstance(data, Mapping):
            return {key: data}
        return {name: value for part, each in data.items() for name, value in flat(each, f"{key}.{part}").items()}

    def short(value: Any) -> str:
        text = "not there" if value is None else json.dumps(value, ensure_ascii=False)
        return text if len(text) <= 60 else f"{text[:57]}..."

    one, two = flat(before, ""), flat(after, "")
    found = [
        f"{key[1:]} was {short(one.get(key))}, now {short(two.get(key))}"
        for key in {**one, **two}
        if one.get(key) != two.get(key)
    ]
    return ", ".join(found[:3]) + (f" and {len(found) - 3} more" if len(found) > 3 else "")


def _name(key: Any) -> str:
    """A key as text; long ones by their digest."""
    text = _text(key)
    return text if len(text) < 100 else sha256(text.encode()).hexdigest()


def _text(value: Any) -> str:
    """JSON in a line, with infinity and NaN."""

    def plain(each: Any) -> Any:
        if isinstance(each, np.ndarray | np.generic):
            return each.tolist()
        return dict(each) if isinstance(each, Mapping) else {one.name: getattr(each, one.name) for one in fields(each)}

    return json.dumps(value, default=plain)


def _read(line: bytes) -> Any:
    """What a line says; None for a torn one."""
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None
