"""What many runs have found, kept at once in a file that is only appended to: whatever ends the process, at most a line that is being
written is torn, and the next process cuts it off."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import OutputFolder


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
            with self.path.open("ab+") as file:
                file.seek(0)
                for line in file:
                    if line.endswith(b"\n"):
                        yield self.size, line
                        self.size += len(line)
                file.truncate(self.size)
        except OSError as error:
            raise ResultsError(f"can't read {self.path}: {error.strerror or error}") from error

    def append(self, text: str) -> None:
        """Append whole lines.

        Raises:
            ResultsError: the disk is full, for example.
        """
        data = memoryview(text.encode())
        self.size += len(data)
        try:
            with self.path.open("ab", buffering=0) as file:
                while data:
                    data = data[file.write(data) :]
        except OSError as error:
            raise ResultsError(f"can't write {self.path}: {error.strerror or error}") from error
