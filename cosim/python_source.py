"""Slaves, blocks and python-control systems of the user's own, named by ``module:name``."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

from flexfmu.cosim.errors import InputError


def from_source(source: str, arguments: Mapping[str, Any]) -> Any:
    """What a class or function returns; modules in the working directory are found too.

    Args:
        source: ``module:name``, for example ``my_controllers:Damper``.
        arguments: its keyword arguments.

    Raises:
        InputError: there is no such module or name, or the call fails.
    """
    module_name, _, name = source.partition(":")
    try:
        with _working_directory():
            found = reduce(getattr, name.split("."), import_module(module_name))
    except ImportError as error:
        raise InputError(f"{source!r}: can't import {module_name}: {error}") from error
    except AttributeError:
        raise InputError(f"{source!r}: module {module_name} has no {name!r}") from None
    if not callable(found):
        return found
    try:
        return found(**arguments)
    except (TypeError, ValueError) as error:
        given = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
        raise InputError(f"{source}({given}): {error}") from error


@contextmanager
def _working_directory() -> Iterator[None]:
    """Let modules be imported from the working directory, after all others."""
    here = str(Path.cwd())
    sys.path.append(here)
    try:
        yield
    finally:
        sys.path.remove(here)
