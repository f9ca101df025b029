"""The base class of all errors of the package; each room has its own, which say what is wrong."""

from __future__ import annotations


class Error(Exception):
    """Something can't be done as asked; the message is one line that names what, where, the value and a remedy."""
