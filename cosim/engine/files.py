"""Files and folders of results: checked before the work starts, every file there whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

from flexfmu.cosim.engine.errors import ResultsError

RESULTS = Path("results")
"""Where results go unless the user says otherwise, in a folder named after the scene."""


@dataclass(frozen=True)
class OutputFolder:
    """A folder for results.

    Attributes:
        path: where it is; made with its parents when it is not there.
    """

    path: Path

    def prepare(self) -> None:
        """Make the folder and try to write into it, so that a long simulation doesn't end at a closed door.

        Raises:
            ResultsError: the folder can't be made or written, with the system's reason.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path) as probe:
                probe.write(b"\0")
        except OSError as error:
            raise _cannot_write(self.path, error) from error

    def write(self, name: str, text: str) -> Path:
        """Write a file of the folder; see `write_whole`."""
        return write_whole(self.path / name, text)


def write_whole(path: Path, text: str) -> Path:
    """Write a file beside its target, then rename it: a reader never sees half of it. Makes the folder if need be.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    temporary = path.parent / f".{path.name}.{os.getpid()}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8", newline="\n")
        return temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _cannot_write(path: Path, error: OSError) -> ResultsError:
    return ResultsError(f"can't write {path}: {error.strerror or error}; choose another folder or free some space")
