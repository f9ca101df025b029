"""Who is at work, for the message when it fails."""

from __future__ import annotations


class Activity:
    """Attributes:
    name: name of the slave that is, or was last, at work.
    """

    __slots__ = ("name",)

    def __init__(self) -> None:
        self.name = ""
