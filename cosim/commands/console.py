"""What the commands say: results on standard output, progress on standard error when somebody watches."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import StringIO
from typing import TextIO

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
        ResultsError: standard output is closed or can't be written, a full disk for example.
    """
    stdout = _stdout()
    try:
        stdout.write(text.encode(stdout.encoding or "utf-8", "replace").decode(stdout.encoding or "utf-8"))
        stdout.flush()
    except BrokenPipeError:
        abandon_stdout()
        raise typer.Exit(1) from None
    except OSError as error:
        abandon_stdout()
        raise ResultsError(f"can't write to standard output: {error.strerror or error}") from error


def print_rich(*parts: RenderableType) -> None:
    """Write tables and styled text to standard output; see `rich_output`."""
    with rich_output() as console:
        for part in parts:
            console.print(part)


@contextmanager
def rich_output() -> Iterator[Console]:
    """A console whose text goes to standard output in the end: as wide as the terminal, and in colours where there is one.

    Raises:
        ResultsError: standard output is closed or can't be written.
    """
    is_terminal, text = _stdout().isatty(), StringIO()
    yield Console(
        file=text, force_terminal=is_terminal or None, width=None if is_terminal else PIPED_WIDTH, highlight=False
    )
    print_text(text.getvalue())


@contextmanager
def progress() -> Iterator[Step]:
    """A progress bar on standard error; nothing when that is piped."""
    stderr: TextIO | None = sys.stderr
    if stderr is None or not stderr.isatty():
        yield lambda text, fraction: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text, fraction: bar.update(
            task, description=text, total=None if fraction is None else 1.0, completed=fraction or 0.0
        )


def _stdout() -> TextIO:
    """Standard output.

    Raises:
        ResultsError: the command was started without one.
    """
    stdout: TextIO | None = sys.stdout
    if stdout is None:
        raise ResultsError("can't write to standard output: it is closed")
    return stdout


def keep_stdout() -> None:
    """Keep standard output for results: what libraries of FMUs print goes to standard error from here on."""
    try:
        own = os.dup(sys.stdout.fileno())
    except (AttributeError, OSError, ValueError):  # there is none
        return
    try:
        os.dup2(2, 1)
    except OSError:  # there is no standard error
        os.close(own)
        return
    sys.stdout = open(own, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)  # noqa: SIM115 - lives as long as the process


def abandon_stdout() -> None:
    """Point standard output to nowhere, or Python complains once more when it flushes at exit."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - lives as long as the process
