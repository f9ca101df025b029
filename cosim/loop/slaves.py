"""Slaves of whatever a user has at hand: blocks, python-control systems, FMUs and slaves, each by a name of its own."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import Any

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.slave import Slave
from flexfmu.model.loop_section import RESERVED


class Names:
    """Names for slaves that can be renamed, each given once."""

    def __init__(self) -> None:
        self._given = set(RESERVED)

    def __contains__(self, name: str) -> bool:
        """Whether a slave has this name."""
        return name in self._given

    def unused(self, wanted: str) -> str:
        """The name, or the name with a number."""
        name, number = wanted, 1
        while name in self._given:
            number += 1
            name = f"{wanted}{number}"
        self._given.add(name)
        return name

    def chosen(self, name: str | None, default: str) -> str:
        """The name that a user has chosen, as it is; otherwise the default, with a number where it is taken.

        Raises:
            InputError: a slave has the chosen name already.
        """
        if name is None:
            return self.unused(default)
        if name in self._given:
            raise InputError(
                f"the name {name!r} is taken: a slave without a name of its own is called after its kind; choose another"
            )
        return self.unused(name)

    def of_file(self, path: str, name: str | None = None) -> str:
        """The name that a user has chosen, or one from a file's name; errors as for `chosen`."""
        return self.chosen(name, "".join(c if c.isalnum() else "_" for c in Path(path).stem) or "fmu")


def as_slave(source: Any, names: Names | None = None, name: str | None = None) -> Slave:
    """A slave from a block, a python-control system, the path of an FMU, or a slave.

    The FMU of a block is sampled like the block, one that can't vary its step at the step size of its default experiment,
    any other is stepped; `flexfmu.cosim.fmu.sampled_slave.fmu_slave` makes one with a sample time.

    Args:
        source: what it is made from.
        names: names given so far.
        name: its name; by default what the block, file or slave is called.

    Raises:
        InputError: it is none of these, the name is taken, or the FMU can't be loaded.
    """
    from flexfmu.cosim.blocks.slave import BlockSlave
    from flexfmu.cosim.fmu.sampled_slave import fmu_slave
    from flexfmu.model.block import SymbolicBlock

    names = names or Names()
    if isinstance(source, SymbolicBlock):
        return BlockSlave(source, names.chosen(name, source.name))
    if type(source).__module__.partition(".")[0] == "control":
        from flexfmu.cosim.controllers.from_control import control_block

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
        f"a {type(source).__name__} can't be a slave: take a SymbolicBlock, a slave, a python-control system or an FMU's path"
    )
