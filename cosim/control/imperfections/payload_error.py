"""Payload error: the robot carries another mass than its controllers and shapers assume."""

from __future__ import annotations

from math import isfinite

from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.schema import Scene


def with_payload_error(scene: Scene, relative: float) -> Scene:
    """Return the scene with (1 + relative) times its payload.

    Build the plant from this scene, controllers and shapers from the original one, or the other way round.

    Args:
        scene: the scene.
        relative: relative error of the mass, for example -0.3 for 30 % less.

    Raises:
        InputError: the error isn't finite or is below -1, or the scene has no payload.
    """
    mass = scene.payload.mass
    if not (isfinite(relative) and relative >= -1.0):
        raise InputError(f"the relative payload error must be finite and at least -1 (no payload), got {relative}")
    if mass == 0.0 and relative:
        raise InputError(
            f"scene {scene.name} has no payload, so {relative:+.0%} of it changes nothing; "
            "give the mass itself: scene.replace({'payload.mass': 0.1})"
        )
    return scene.replace({"payload.mass": mass * (1.0 + relative)})
