"""Slaves, blocks and python-control systems of the user's own, named by ``module:name``."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, reduce
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from flexfmu.cosim.errors import InputError


def from_source(source: str, arguments: Mapping[str, Any], folder: str | Path = ".") -> Any:
    """What a class or function returns.

    Args:
        source: ``module:name``, for example ``my_controllers:Damper``.
        arguments: its keyword arguments.
        folder: where the module is looked for first; then among installed modules, then in the working directory. Modules
            of the same name in different folders are different modules.

    Raises:
        InputError: there is no such module or name, it can't be imported, or the call fails.
    """
    module_name, _, name = source.partition(":")
    try:
        with _searched(Path(folder), Path.cwd()):
            module = _module(module_name, Path(folder))
    except SyntaxError as error:
        raise InputError(f"{source!r}: {module_name} isn't valid Python: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{source!r}: can't import {module_name}: {_described(error)}") from error
    try:
        found = reduce(getattr, name.split("."), module)
    except AttributeError:
        raise InputError(f"{source!r}: module {module_name} has no {name!r}") from None
    if not callable(found):
        return found
    try:
        return found(**arguments)
    except (Exception, SystemExit) as error:
        given = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
        raise InputError(f"{source}({given}): {_described(error)}") from error


def _described(error: Exception | SystemExit) -> str:
    """Kind, words and place of an error in a user's code."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def _module(name: str, folder: Path) -> ModuleType:
    """The module of a folder, else an installed one."""
    file = folder.resolve() / f"{name}.py"
    return _loaded(file) if file.is_file() else import_module(name)


@cache
def _loaded(file: Path) -> ModuleType:
    """The module of a file, under a name that no other has; executed once."""
    spec = spec_from_file_location(f"{file.stem} of {file.parent}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python file")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@contextmanager
def _searched(*folders: Path) -> Iterator[None]:
    """Let modules be imported from these folders, after all others."""
    added = [str(folder) for folder in folders]
    sys.path.extend(added)
    try:
        yield
    finally:
        for each in added:
            sys.path.remove(each)
