"""Exceptions and warnings of scenes and models; each message gives value, place and remedy."""

from __future__ import annotations

from flexfmu.errors import Error


class SceneError(Error, ValueError):
    """An invalid scene file or value; the message gives key, value, unit and remedy."""


class SceneWarning(UserWarning):
    """A valid value that suggests a mistake, for example a wrong unit."""


class EquilibriumError(Error, ArithmeticError):
    """No (stable) static equilibrium, or no convergence of the finite elements; the message gives pose or time."""
