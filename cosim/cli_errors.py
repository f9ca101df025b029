"""Errors as the command line shows them: one line on standard error, and an exit status.

0: done. 1: it ran and failed. 2: wrong usage or input, nothing was done.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from flexfmu.cosim.errors import CosimError, InputError
from flexfmu.fmu_build.errors import BuildError, MissingCompilerError, PlatformError
from flexfmu.model.errors import EquilibriumError, SceneError
from flexfmu.trajectories.errors import TrajectoryError

FAILURE, USAGE = 1, 2

_USAGE_ERRORS = (SceneError, TrajectoryError, InputError, PlatformError)
_FAILURES = (CosimError, BuildError, EquilibriumError)


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn every error that a user can meet into one line on standard error and the exit status.

    Anything else is a mistake in flexfmu and keeps its traceback.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise _exit("interrupted", FAILURE) from None
    except MissingCompilerError as error:
        raise _exit(str(error), FAILURE) from error
    except _USAGE_ERRORS as error:
        raise _exit(str(error), USAGE) from error
    except _FAILURES as error:
        raise _exit(str(error), FAILURE) from error
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        raise _exit(f"{error.strerror or error}{where}", FAILURE) from error


def show_error(message: str) -> None:
    """One line on standard error."""
    print(f"flexfmu: {' '.join(message.split())}", file=sys.stderr)


def _exit(message: str, status: int) -> typer.Exit:
    show_error(message)
    return typer.Exit(status)
