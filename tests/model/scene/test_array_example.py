"""Error messages about arrays show one of the kind that the key takes."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from flexfmu.model.scene.controllers import StateSpaceSection
from flexfmu.model.scene.effects import Effects
from flexfmu.model.scene.messages import array_example
from flexfmu.model.scene.motion import TrajectorySection


@pytest.mark.parametrize(
    ("section", "key", "example"),
    [
        (TrajectorySection, "start", "[1.0, 2.0]"),
        (Effects, "quasi_static", '["proximal_bending", "proximal_axial"]'),
        (Effects, "of", '["peak_torque_1", "peak_torque_2"]'),
        (StateSpaceSection, "inputs", '["a", "b"]'),
        (StateSpaceSection, "D", "[[1.0, 2.0], [1.0, 2.0]]"),
        (StateSpaceSection, "A[1]", "[1.0, 2.0]"),
        (None, "anything", "[1.0, 2.0]"),
    ],
)
def test_examples_are_of_the_type_that_the_key_takes(section: type[BaseModel] | None, key: str, example: str) -> None:
    """Vectors, names out of a list, free names, matrices and their rows, optional or not."""
    assert array_example(section, key) == example
