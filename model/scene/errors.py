"""What can go wrong in a model, each with the value, the place and the remedy in one sentence."""

from __future__ import annotations


class SceneError(ValueError):
    """A scene file or a scene value that can't be used: names the key, the value, the unit and what would be right."""


class SceneWarning(UserWarning):
    """A scene can be used, but a value in it suggests a mistake, in its unit for example."""


class EquilibriumError(ArithmeticError):
    """No static equilibrium was found: names the pose and what the iteration saw last."""
