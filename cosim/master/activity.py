"""Who is at work, for the message when it fails."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import Structure, c_int, sizeof
from mmap import mmap


class Activity(Structure):
    """In memory that child processes share, so that their parent sees it.

    Attributes:
        names: names of the slaves.
        slave: index of the one that is, or was last, at work.
    """

    _fields_ = (("slave", c_int),)
    slave: int
    names: Sequence[str] = ()

    @classmethod
    def of(cls, names: Sequence[str]) -> Activity:
        """Nobody of these has been at work yet."""
        activity = cls.from_buffer(mmap(-1, sizeof(cls)))
        activity.names = tuple(names)
        return activity

    @property
    def name(self) -> str:
        """Name of the slave that is, or was last, at work."""
        return self.names[self.slave]
