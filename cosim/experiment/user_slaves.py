"""Makes slaves from a user's blocks, python-control systems, FMUs, Python slaves and functions ``module:name``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, reduce
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from os import PathLike, fspath
from pathlib import Path
from types import ModuleType
from typing import Any

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Slave
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.loop import RESERVED


class SlaveNames:
    """Assigns unique names to slaves."""

    def __init__(self, reserved: Iterable[str] = RESERVED) -> None:
        self._given = set(reserved)

    def __contains__(self, name: str) -> bool:
        """Whether the name is assigned or reserved."""
        return name in self._given

    def unused(self, wanted: str) -> str:
        """Assign the name, with a number appended if it is taken."""
        name, number = wanted, 1
        while name in self._given:
            number += 1
            name = f"{wanted}{number}"
        self._given.add(name)
        return name

    def chosen(self, name: str | None, default: str) -> str:
        """Assign the user's name unchanged, else the default, with a number appended if it is taken.

        Raises:
            InputError: the user's name is taken.
        """
        if name is None:
            return self.unused(default)
        if name in self._given:
            raise InputError(
                f"the name {name!r} is taken: a slave without a name of its own is called after its kind; choose another"
            )
        return self.unused(name)

    def of_file(self, path: str, name: str | None = None) -> str:
        """Assign the user's name, or one from the file's name; errors as for `chosen`."""
        return self.chosen(name, "".join(c if c.isalnum() else "_" for c in Path(path).stem) or "fmu")


def as_slave(source: Any, names: SlaveNames | None = None, name: str | None = None) -> Slave:
    """Make a slave from a model of equations, a function with `flexfmu.controller`, a block, a python-control system, the path of an FMU,
    or a slave.

    The FMU of a block has the sample time of the block; an FMU without variable step is sampled at the step size of its
    default experiment; all others make communication steps. For another sample time use
    `flexfmu.cosim.engine.fmu.sampled_slave.fmu_slave`.

    Args:
        source: model, function, block, python-control system, path or slave.
        names: names assigned so far.
        name: name of the slave; by default from the block, file or slave.

    Raises:
        InputError: the source is none of these, the name is taken, or the FMU can't be loaded.
        BuildError: the FMU of a model can't be built.
    """
    from flexfmu.cosim.control.blocks.slave import BlockSlave
    from flexfmu.cosim.control.controllers.own_function import FunctionController
    from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
    from flexfmu.model.symbolic import SymbolicBlock, SymbolicModel

    names = names or SlaveNames()
    if isinstance(source, SymbolicModel):
        return fmu_slave(build_fmu(source).path, names.of_file(source.name, name))
    if isinstance(source, SymbolicBlock):
        return BlockSlave(source, names.chosen(name, source.name))
    if isinstance(source, FunctionController):
        return source.slave(names.chosen(name, source.name))
    if type(source).__module__.partition(".")[0] == "control":
        from flexfmu.cosim.control.controllers.from_control import control_block

        return BlockSlave(control_block(source), names.chosen(name, "controller"))
    if isinstance(source, (str, PathLike)):
        path = fspath(source)
        return fmu_slave(path, names.of_file(path, name))
    if all(hasattr(source, part) for part in ("name", "variables", "initialize", "set", "get")):
        slave: Slave = source
        if name is not None and slave.name != name:
            slave.name = name  # type: ignore[misc]
        return slave
    raise InputError(
        f"a {type(source).__name__} can't be a slave: take a model, a function with @flexfmu.controller, a SymbolicBlock, a slave, a "
        "python-control system or an FMU's path"
    )


def from_source(source: str, arguments: Mapping[str, Any], folder: str | Path = ".") -> Any:
    """Import ``module:name`` and call it with the arguments, which are the parameters of a function with the decorator
    `flexfmu.controller`; an object that is not callable is returned as it is.

    Args:
        source: ``module:name``, for example ``my_controllers:Damper``.
        arguments: keyword arguments of the call.
        folder: folder that is searched first, before installed modules and the working directory. Modules of the same
            name in different folders are different modules.

    Raises:
        InputError: the module or name doesn't exist, the import fails, or the call fails.
    """
    from flexfmu.cosim.control.controllers.own_function import FunctionController, described

    # import the module from the folder or the installed ones
    module_name, _, name = source.partition(":")
    try:
        with _searched(Path(folder), Path.cwd()):
            file = Path(folder).resolve() / f"{module_name}.py"
            module = _loaded(file) if file.is_file() else import_module(module_name)
    except SyntaxError as error:
        raise InputError(f"{source!r}: {module_name} isn't valid Python: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{source!r}: can't import {module_name}: {described(error)}") from error
    try:
        found = reduce(getattr, name.split("."), module)
    except AttributeError:
        raise InputError(f"{source!r}: module {module_name} has no {name!r}") from None
    # return the object, or the result of calling it
    if not callable(found):
        return found
    if isinstance(found, FunctionController):
        return found.changed(arguments)
    try:
        return found(**arguments)
    except (Exception, SystemExit) as error:
        given = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
        raise InputError(f"{source}({given}): {described(error)}") from error


@cache
def _loaded(file: Path) -> ModuleType:
    """The module of a file, imported once under a unique name."""
    spec = spec_from_file_location(f"{file.stem} of {file.parent}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python file")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses need their module here
    spec.loader.exec_module(module)
    return module


@contextmanager
def _searched(*folders: Path) -> Iterator[None]:
    """Append these folders to the module search path temporarily."""
    added = [str(folder) for folder in folders]
    sys.path.extend(added)
    try:
        yield
    finally:
        for each in added:
            sys.path.remove(each)
