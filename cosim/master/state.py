"""Saved states of several slaves, to go back to and to let go of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import cast

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.slave import KnowsItsFuture, Sampled, SavesState, Slave, can_save


def check_can_save(slaves: Iterable[Slave], purpose: str) -> None:
    """Refuse slaves that can't go back.

    Raises:
        InputError: a slave can't save and restore its state.
    """
    for slave in slaves:
        if not can_save(slave):
            raise InputError(
                f"{slave.name} can't save and restore its state, which {purpose} needs; give it `save` and `restore` "
                f"(an FMU needs canGetAndSetFMUstate), or run without"
            )


def revocable(slaves: Iterable[Slave]) -> list[Slave]:
    """Slaves whose state moves on in a step; one that knows its future is told to go back, one that samples stays."""
    return [slave for slave in slaves if not isinstance(slave, KnowsItsFuture | Sampled)]


class StateKeeper:
    """The states of slaves at the time when it is made; let go at the end of a ``with`` block."""

    def __init__(self, slaves: Sequence[Slave]) -> None:
        self._states: list[tuple[SavesState, object]] = []
        for slave in slaves:
            keeper = cast(SavesState, slave)
            self._states.append((keeper, keeper.save()))

    def restore(self) -> None:
        """Go back; may be repeated."""
        for slave, state in self._states:
            slave.restore(state)

    def __enter__(self) -> StateKeeper:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def release(self) -> None:
        """Let the states go."""
        for slave, state in self._states:
            # `ReleasesStates`, asked thousands of times
            if (release := getattr(slave, "release", None)) is not None:
                release(state)
        self._states = []
