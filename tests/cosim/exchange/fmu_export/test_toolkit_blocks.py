"""The toolkit's own controllers, shapers and imperfections leave as FMUs and give the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import fmpy
import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, expected
from export_support.instance import run
from export_support.kinds import KINDS, motion, seen_late
from numpy.lib.recfunctions import unstructured_to_structured

from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.scene.messages import sections_in, tags_of
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock

pytestmark = pytest.mark.slow


def tags(*keys: str) -> set[str]:
    """Kinds of a scene's sections."""
    fields = [Scene.model_fields[key].annotation for key in keys]
    return {tag for field in fields for section in sections_in(field) for tag in tags_of(section)}


EXACT = tags("imperfection")
"""They sum little."""

COUNT = 200
"""Samples: four stages of the source, five cycles of what learns, and more than the memory of what delays."""


def in_fmpy(block: SymbolicBlock, inputs: Any) -> Any:
    """Outputs (count, outputs) of the block's FMU at the instants in `fmpy.simulate_fmu`, inputs (count, inputs) given."""
    time = np.arange(len(inputs)) * block.sample_time
    names = ["time", *(each.name for each in block.inputs)]
    table = unstructured_to_structured(np.column_stack([time, inputs]), np.dtype([(name, float) for name in names]))
    result = fmpy.simulate_fmu(
        str(build_fmu(block).path),
        input=table,
        output=[each.name for each in block.outputs],
        output_interval=block.sample_time,
        stop_time=time[-1],
    )
    return np.column_stack([result[each.name] for each in block.outputs])


def assert_rounding(found: Any, exact: Any, name: str = "") -> None:
    """Equal to rounding, relative to the largest value; imperfections, which sum little, to the last bits."""
    assert abs(exact).max() > 0.0
    is_exact = name.partition(":")[0] in EXACT
    tolerance = 1e-15 if is_exact else 1e-12 * max(1.0, abs(exact).max())
    np.testing.assert_allclose(found, exact, rtol=1e-15 if is_exact else 0.0, atol=tolerance)


def test_no_kind_is_left_out() -> None:
    """A new kind of controller, imperfection, filter or disturbance is tried in other importers, too."""
    found = tags("controller", "imperfection", "filter", "disturbance") - {
        "python",
        "fmu",
        "object",
        "payload-error",
        "parameter-error",
    }
    assert found <= {name.partition(":")[0] for name in KINDS}


@pytest.mark.parametrize("name", KINDS)
def test_exported_block_is_its_functions(name: str, export: Callable[..., Any]) -> None:
    """The same numbers to rounding where inputs are set before outputs are read, random numbers included; to the last bit
    after rollbacks; and one sample later where fmpy reads first, never one of new states and old inputs."""
    block = KINDS[name]()
    inputs = motion(block, COUNT)
    make = export(block)
    found = run(make(), inputs, SAMPLE_TIME)
    assert_rounding(found, expected(block, inputs), name)
    np.testing.assert_array_equal(run(make("again"), inputs, SAMPLE_TIME, rollback=40), found)
    assert_rounding(in_fmpy(block, inputs), seen_late(block, inputs), name)


@pytest.mark.parametrize(("name", "fmi"), [("pid", "3"), ("computed-torque", "2"), ("learning", "3"), ("shaper", "2")])
def test_exported_block_is_valid(name: str, fmi: FmiVersion) -> None:
    """Descriptions with every unit and limit, and a short life with the start values of all inputs, or with others at ticks."""
    assert validate_fmu(build_fmu(KINDS[name](), stop_time=0.1, fmi=fmi).path) == []
