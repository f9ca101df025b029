"""Payload error: only the mass changes."""

from __future__ import annotations

import pytest

from flexfmu.cosim.control.sections import with_payload_error
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.file import load_scene


@pytest.mark.parametrize("relative", [-1.0, -0.3, 0.0, 0.3])
def test_only_the_mass_changes(relative: float) -> None:
    """The scene is the same but for the payload, so that nothing else explains a difference."""
    scene = load_scene("barnard2012-6kg")
    wrong = with_payload_error(scene, relative)
    assert wrong.payload.mass == 6.0 * (1.0 + relative)
    assert wrong.replace({"payload.mass": 6.0}) == scene


@pytest.mark.parametrize("relative", [-1.1, float("nan"), float("inf")])
def test_impossible_errors(relative: float) -> None:
    """A mass is zero or positive and finite."""
    with pytest.raises(InputError, match=r"at least -1 \(no payload\), got"):
        with_payload_error(load_scene("barnard2012-6kg"), relative)


def test_no_payload_to_be_wrong_about() -> None:
    """A part of nothing is nothing; saying nothing would hide that."""
    empty = load_scene("barnard2012-6kg").replace({"payload.mass": 0.0})
    assert with_payload_error(empty, 0.0) == empty
    with pytest.raises(InputError, match=r"has no payload, so -30% of it changes nothing"):
        with_payload_error(empty, -0.3)
