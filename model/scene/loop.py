"""What every section of a controller, shaper or imperfection has: a name, connections, a sample time; and slaves of the
user's own."""

from __future__ import annotations

from pathlib import Path
from sys import float_info
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from flexfmu.model.scene.section import Positive, Seconds, SecondsOrZero, Section, quantity

RESERVED = {"plant": "the robot's", "trajectory": "the planned motion's"}
"""Names of slaves that every scene has → whose they are."""


def _not_reserved(name: str) -> str:
    """Refuse a name that a slave of every scene has."""
    if name in RESERVED:
        raise ValueError(f"{name!r} is {RESERVED[name]} own name, choose another")
    return name


Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$"), AfterValidator(_not_reserved)]


FOLDER = "folder"
"""Key of the validation context under which the scene file's folder stands."""


def _from_scene_file(path: str, info: ValidationInfo) -> str:
    """The absolute path of one relative to the scene file's folder; unchanged where the scene doesn't come from a
    file."""
    folder: Path | None = (info.context or {}).get(FOLDER)
    return path if folder is None else str(folder / path)


def _one_value(value: Any) -> Any:
    """What a parameter may be, checked at once: pydantic would say it for each type of the union."""
    if isinstance(value, str | bool) or (isinstance(value, float | int) and abs(value) <= float_info.max):
        return value
    raise ValueError(f"give one finite number, true, false or a text in quotes, got {value!r}")


ParameterValue = Annotated[float | int | bool | str, BeforeValidator(_one_value)]


class LoopSection(Section):
    """A slave's name in the system, and connections that names alone don't make.

    `connect` maps an input to its source: `{ "error" = "joint1.position" }`, or with the names of the slaves
    `{ "plant.joint1.torque" = "mine.torque" }`.
    """

    name: Name | None = None
    connect: dict[str, str] = Field(default_factory=dict)

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


class SampledSection(LoopSection):
    """A slave with a sample time of its own."""

    sample_time: Seconds
    offset: SecondsOrZero = 0.0


class PythonSection(LoopSection):
    """A slave, block or python-control system that a Python function or class returns.

    `source` is `module:name`; the module is looked for in `folder`, relative to the scene file's folder and that
    folder by default, then among installed modules and in the working directory.
    """

    kind: Literal["python"]
    source: Annotated[str, Field(pattern=r"^[\w.]+:[\w.]+$")]
    folder: Annotated[str, AfterValidator(_from_scene_file)] = Field(default=".", validate_default=True)
    arguments: dict[str, Any] = Field(default_factory=dict)


class FmuSection(LoopSection):
    """Any FMI 2.0 co-simulation FMU; `path` is relative to the scene file's folder.

    With a `sample_time` it is stepped at its own instants only, its inputs sampled and its outputs held; without one an
    exported block has its own, an FMU that can't vary its communication step takes the step size of its default
    experiment, and any other is stepped. `output_order` is the highest derivative of its outputs that is used, 0 for
    none; by default what its description says and the FMU delivers.
    """

    kind: Literal["fmu"]
    path: Annotated[str, AfterValidator(_from_scene_file)]
    parameters: dict[str, ParameterValue] = Field(default_factory=dict)
    sample_time: Annotated[Positive | None, quantity("s")] = None
    offset: SecondsOrZero = 0.0
    output_order: Annotated[int | None, Field(ge=0)] = None
