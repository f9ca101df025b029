"""Errors as the command line shows them: one line on standard error, and an exit status.

0: done. 1: it ran and failed. 2: wrong usage or input, nothing was done.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import typer

FAILURE, USAGE = 1, 2


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn every error that a user can meet into one line on standard error and the exit status.

    Anything else is a mistake in flexfmu and keeps its traceback. Warnings that concern the user are one line each as well.
    """
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _showing(warnings.showwarning)
            yield
    except typer.Exit:
        raise
    except KeyboardInterrupt:
        show_error("interrupted")
        raise typer.Exit(FAILURE) from None
    except Exception as error:
        status = _exit_status(error)
        if status is None:
            raise
        show_error(_sentence(error))
        raise typer.Exit(status) from error


def show_error(message: str) -> None:
    """One line on standard error, if there is one."""
    show_note(message)


def show_note(message: str) -> None:
    """One line on standard error for something that isn't a result, if there is a standard error."""
    stderr: TextIO | None = sys.stderr
    if stderr is not None:
        print(f"flexfmu: {' '.join(message.split())}", file=stderr)


def _showing(others: Callable[..., None]) -> Callable[..., None]:
    """Shows a warning that concerns the user without the line of code that it comes from; others as before."""
    from flexfmu.cosim.errors import CostWarning, SlaveWarning
    from flexfmu.fmu_build.errors import CacheWarning
    from flexfmu.model.errors import SceneWarning

    def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
        if issubclass(category, CacheWarning | CostWarning | SceneWarning | SlaveWarning):
            show_note(f"warning: {message}")
        else:
            others(message, category, *where)

    return show


def _exit_status(error: Exception) -> int | None:
    """The exit status for an error; None for a mistake in flexfmu.

    The families of errors are imported here: `flexfmu --help` would wait for SciPy otherwise.
    """
    from flexfmu.cosim.errors import CosimError, InputError
    from flexfmu.fmu_build.errors import BuildError, MissingCompilerError, PlatformError, StartError
    from flexfmu.model.errors import EquilibriumError, SceneError
    from flexfmu.trajectories.errors import TrajectoryError

    if isinstance(error, MissingCompilerError):
        return FAILURE
    if isinstance(error, SceneError | TrajectoryError | InputError | PlatformError | StartError):
        return USAGE
    return FAILURE if isinstance(error, CosimError | BuildError | EquilibriumError | OSError) else None


def _sentence(error: Exception) -> str:
    """The error's own words, the system's where it comes from there."""
    if isinstance(error, OSError):
        where = f" ({error.filename})" if error.filename else ""
        return f"{error.strerror or error}{where}"
    return str(error)
