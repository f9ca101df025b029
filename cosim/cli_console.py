"""What the commands say: results on standard output, progress on standard error when somebody watches."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer
from rich.console import Console, RenderableType

from flexfmu.cosim.errors import ResultsError

PIPED_WIDTH = 120
"""Columns of a table that goes into a file or another program."""

Step = Callable[[str, float | None], None]
"""Called with what is being done and the finished fraction, 0..1; None where it isn't known."""


def print_text(text: str) -> None:
    """Write to standard output at once. A reader that has gone away ends the command without a word.

    Raises:
        ResultsError: standard output can't be written, a full disk for example.
    """
    try:
        sys.stdout.write(_writable(text))
        sys.stdout.flush()
    except BrokenPipeError:
        _abandon_stdout()
        raise typer.Exit(1) from None
    except OSError as error:
        _abandon_stdout()
        raise ResultsError(f"can't write to standard output: {error.strerror or error}") from error


def print_rich(*parts: RenderableType) -> None:
    """Write tables and styled text to standard output, in colours where it is a terminal."""
    console = stdout_console()
    with console.capture() as capture:
        for part in parts:
            console.print(part)
    print_text(capture.get())


def stdout_console() -> Console:
    """A console on standard output, as wide as the terminal."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else PIPED_WIDTH)


@contextmanager
def progress() -> Iterator[Step]:
    """A progress bar on standard error; nothing when that is piped."""
    if not sys.stderr.isatty():
        yield lambda text, fraction: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text, fraction: bar.update(
            task, description=text, total=None if fraction is None else 1.0, completed=fraction or 0.0
        )


def _writable(text: str) -> str:
    """The text with characters that standard output can't encode replaced."""
    encoding = sys.stdout.encoding or "utf-8"
    return text.encode(encoding, "replace").decode(encoding)


def _abandon_stdout() -> None:
    """Point standard output to nowhere, or Python complains once more when it flushes at exit."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - lives as long as the process
