"""Files and folders of results: the folder is checked before a simulation and kept from other processes, and each file is written
atomically; and the text of JSON."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.errors import PART, make_folder, remove_empty
from flexfmu.errors import replacing as replacing_file

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

RESULTS = Path("results")
"""Default folder of results; each scene has a folder of its own name in it."""


@dataclass(frozen=True)
class OutputFolder:
    """A folder for results.

    Attributes:
        path: path of the folder; created with its parents if it doesn't exist.
    """

    path: Path

    def prepare(self) -> list[Path]:
        """Create the folder and write a trial file, so that a long simulation doesn't fail when it saves its results.

        Returns:
            the folders that were missing, from the deepest up.

        Raises:
            ResultsError: the folder can't be created or written to, with the system's reason.
        """
        made: list[Path] = []
        try:
            made = make_folder(self.path)
            with tempfile.TemporaryFile(dir=self.path) as probe:
                probe.write(b"\0")
            return made
        except OSError as error:
            remove_empty(made)
            raise _cannot_write(self.path, error) from error

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """A context in which no other process works in the folder, so that the files of two runs don't mix.

        The folder is prepared, and removed again if nothing was written.

        Raises:
            ResultsError: another process does, or as for `prepare`.
        """
        made, path = self.prepare(), self.path / ".lock"
        try:
            file = locked(path)
            # a file that its last owner has removed in the meantime locks nothing
            while not (path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())):
                file.close()
                file = locked(path)
        except BlockingIOError:
            message = f"another command works in {self.path}: wait for its end, or choose another folder with --out"
            raise ResultsError(message) from None
        try:
            # nobody else works here: these are of processes that were killed
            for part in self.path.glob(f".*-*{PART}"):
                part.unlink(missing_ok=True)
            yield
        finally:
            with contextlib.suppress(OSError):
                path.unlink()
            file.close()
            remove_empty(made)

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


def locked(path: Path, *, wait: bool = False) -> IO[str]:
    """A file that no other process gets until it is closed; where files can't be locked others get it as well.

    Raises:
        BlockingIOError: another process has it, and this one doesn't ``wait``.
    """
    file = path.open("a")
    try:
        if fcntl is not None:
            fcntl.lockf(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))  # not inherited by processes
    except (BlockingIOError, PermissionError) as error:
        file.close()
        raise BlockingIOError(*error.args) from None
    except OSError:
        pass
    return file


def file_digest(path: Path) -> str:
    """SHA-256 of a file as hexadecimal digits, which tells the results of one run from those of another."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
    """As `flexfmu.errors.replacing`.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    try:
        with replacing_file(path) as temporary:
            yield temporary
    except OSError as error:
        raise _cannot_write(path, error) from error


def _cannot_write(path: Path, error: OSError) -> ResultsError:
    return ResultsError(f"can't write {path}: {error.strerror or error}; choose another folder or free some space")
