"""Files and folders of results: the folder is checked before a simulation, each file is written atomically; and the text of JSON."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexfmu.cosim.engine.errors import ResultsError

RESULTS = Path("results")
"""Default folder of results; each scene has a folder of its own name in it."""


@dataclass(frozen=True)
class OutputFolder:
    """A folder for results.

    Attributes:
        path: path of the folder; created with its parents if it doesn't exist.
    """

    path: Path

    def prepare(self) -> None:
        """Create the folder and write a trial file, so that a long simulation doesn't fail when it saves its results.

        Raises:
            ResultsError: the folder can't be created or written to, with the system's reason.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path) as probe:
                probe.write(b"\0")
        except OSError as error:
            raise _cannot_write(self.path, error) from error

    def write(self, name: str, text: str) -> Path:
        """Write a file in the folder and return its path; see `write_whole`."""
        return write_whole(self.path / name, text)

    def remove(self, name: str) -> None:
        """Remove a file of an earlier run, if there is one.

        Raises:
            ResultsError: it can't be removed, with the system's reason.
        """
        try:
            (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            raise _cannot_write(self.path / name, error) from error


def to_json(data: Mapping[str, Any]) -> str:
    """Return JSON text with a final line break; raise ValueError for NaN and infinity, which JSON doesn't have."""
    return json.dumps(data, ensure_ascii=False, indent=2, allow_nan=False) + "\n"


def write_whole(path: Path, text: str) -> Path:
    """Write a file atomically; see `write_pieces`."""
    return write_pieces(path, [text])


def write_pieces(path: Path, pieces: Iterable[str]) -> Path:
    """Write a text file atomically and return its path; see `replacing`."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(pieces)
    return path


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, which it replaces when the context ends without an error; creates the folder if needed.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    temporary = path.parent / f".{path.name}.{os.getpid()}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _cannot_write(path: Path, error: OSError) -> ResultsError:
    return ResultsError(f"can't write {path}: {error.strerror or error}; choose another folder or free some space")
