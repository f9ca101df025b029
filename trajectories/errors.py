"""The one exception of this package."""

from __future__ import annotations


class TrajectoryError(ValueError):
    """A trajectory that cannot be planned or evaluated as asked.

    The message is one line with the value, where it was found, its unit, the limits, and what to change.
    """
