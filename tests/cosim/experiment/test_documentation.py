"""The page on the control loop tells no lies: its examples are scenes, and it knows every kind and key."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, get_args

import pytest

from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.controllers import ControllerSection
from flexfmu.model.scene.cosimulation import AndersonSection, FixedPointSection, StepControl
from flexfmu.model.scene.disturbances import DisturbanceKind
from flexfmu.model.scene.imperfections import ImperfectionSection
from flexfmu.model.scene.loop import FmuSection, PythonSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.shapers import ShaperSection

PAGE = (Path(__file__).parents[3] / "docs" / "control-loop.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
KINDS = [
    kind
    for section in (ControllerSection, ShaperSection, ImperfectionSection, DisturbanceKind)
    for kind in get_args(get_args(section)[0])
]

OWN = (FmuSection, PythonSection)
SECTIONS = [
    each for each in dict.fromkeys([*KINDS, StepControl, AndersonSection, FixedPointSection]) if each not in OWN
]


@pytest.mark.parametrize("block", BLOCKS)
def test_examples_are_scenes(robot: Scene, block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every block can be read, and its slaves be made and named; files that it names are examples."""
    monkeypatch.chdir(Path(__file__).parents[3] / "examples")
    data = tomllib.loads(block)
    changes: dict[str, Any] = {f"cosimulation.{key}": value for key, value in data.pop("cosimulation", {}).items()}
    loop = loop_of(robot.replace(changes | data))
    made = [each for each in loop.controllers if each.name != "feedforward_sum"]
    assert len(made) == sum(map(slaves_of, data.get("controller", [])))


def slaves_of(controller: dict[str, Any]) -> int:
    """Number of slaves of a table: each loop of a cascade is one."""
    return sum(loop in controller for loop in ("position", "velocity", "current")) or 1


@pytest.mark.parametrize("section", SECTIONS)
def test_every_key_is_named(section: Any) -> None:
    """Whoever adds a key adds it to the page."""
    for kind in get_args(section.model_fields["kind"].annotation) if "kind" in section.model_fields else ():
        assert kind in PAGE
    for key in section.model_fields:
        assert re.search(rf"\b{key}\b", PAGE), f"{section.__name__}.{key}"


@pytest.mark.slow
def test_the_example_of_imperfections_settles(robot: Scene) -> None:
    """Whoever copies it gets a loop that comes to rest, with the lag alone and with all of its imperfections: within twice
    the deflection of a spring like the proportional gain."""
    (block,) = (each for each in BLOCKS if '"lag"' in each)
    data = tomllib.loads(block)
    (gain,) = (each["proportional"] for each in data["controller"])
    lags = [each for each in data["imperfection"] if each["kind"] == "lag"]
    for imperfections in (lags, data["imperfection"]):
        run = run_scene(robot.replace({**data, "imperfection": imperfections, "trajectory.dwell": 0.25}))
        assert run.completed, run.message
        last = run.recording.time > run.recording.time[-1] - 0.05
        for joint in ("joint1", "joint2"):
            found, wanted, torque = (
                run.recording[f"{joint}.{signal}"].values[last]
                for signal in ("position", "reference.position", "torque")
            )
            assert abs(found - wanted).max() < 2.0 * abs(torque.mean()) / gain
    delays = {each.connection: each for each in run.delays}
    assert delays["lag.joint1.torque -> plant.joint1.torque"].average == lags[0]["time_constant"]
