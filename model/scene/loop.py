"""Common keys of controllers, shapers and imperfections (name, connections, sample time), and user-defined slaves."""

from __future__ import annotations

from datetime import date, time
from pathlib import Path
from sys import float_info
from typing import Annotated, Any, Literal, Self, TypedDict

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, ValidationInfo, model_validator
from pydantic.json_schema import SkipJsonSchema

from flexfmu.model.scene.section import Positive, Seconds, SecondsOrZero, Section, quantity

RESERVED = {"plant": "the robot's", "trajectory": "the planned motion's"}
"""Reserved names of slaves → their owners, for messages."""


def _not_reserved(name: str) -> str:
    """The name, unless it is reserved.

    Raises:
        ValueError: the name is reserved.
    """
    if name in RESERVED:
        raise ValueError(f"{name!r} is {RESERVED[name]} own name, choose another")
    return name


Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$"), AfterValidator(_not_reserved)]


FOLDER = "folder"
"""Key of the scene file's folder in the validation context."""


def from_scene_file(path: str, info: ValidationInfo) -> str:
    """The path, made absolute from the scene file's folder; unchanged where the scene doesn't come from a file."""
    folder: Path | None = (info.context or {}).get(FOLDER)
    return path if folder is None else str(folder / path)


def _one_value(value: Any) -> Any:
    """The value of a parameter; one check for all types, as pydantic reports an error for each type of a union."""
    if isinstance(value, str | bool) or (isinstance(value, float | int) and abs(value) <= float_info.max):
        return value
    raise ValueError(f"give one finite number, true, false or a text in quotes, got {value!r}")


ParameterValue = Annotated[float | int | bool | str, BeforeValidator(_one_value)]


class LoopSection(Section):
    """Name of a slave, and connections between signals of different names.

    `connect` maps an input to its source: `{ "error" = "joint1.position" }`, or with slave names
    `{ "plant.joint1.torque" = "mine.torque" }`.
    """

    name: Name | None = None
    connect: dict[str, str] = Field(default_factory=dict)

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


class Sampling(TypedDict):
    """Sample time and offset [s] of a block."""

    sample_time: float
    offset: float


class SampledSection(LoopSection):
    """A slave with its own sample time."""

    sample_time: Seconds
    offset: SecondsOrZero = 0.0

    @property
    def sampling(self) -> Sampling:
        """Sample time and offset [s]."""
        return Sampling(sample_time=self.sample_time, offset=self.offset)


class PythonSection(LoopSection):
    """A slave, block or python-control system that a Python function or class returns.

    `source` is `module:name`. The module is searched in `folder` (relative to the scene file's folder, by default that
    folder), then among installed modules and in the working directory.
    """

    kind: Literal["python"]
    source: Annotated[str, Field(pattern=r"^[\w.]+:[\w.]+$")]
    folder: Annotated[str, AfterValidator(from_scene_file)] = Field(default=".", validate_default=True)
    arguments: dict[str, Any] = Field(default_factory=dict)


class FmuSection(LoopSection):
    """Any FMI 2.0 co-simulation FMU; `path` is relative to the scene file's folder.

    With a `sample_time` it is stepped at its sample instants only: inputs are sampled, outputs held. Without one, an
    exported block has its own sample time; an FMU with a fixed communication step uses the step size of its default
    experiment, or its fixed internal one; any other FMU takes the communication steps. `output_order` is the highest
    output derivative that is used, 0 for none; by default the order that the FMU declares and provides.
    """

    kind: Literal["fmu"]
    path: Annotated[str, AfterValidator(from_scene_file)]
    parameters: dict[str, ParameterValue] = Field(default_factory=dict)
    sample_time: Annotated[Positive | None, quantity("s")] = None
    offset: SecondsOrZero = 0.0
    output_order: Annotated[int | None, Field(ge=0)] = None


class Held:
    """Holds an object of the caller's program, which copies and dumps of a scene hand on as it is."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __repr__(self) -> str:
        """Type and address of the object."""
        return f"<{type(self.value).__name__} at {id(self.value):#x}>"


def _held(value: Any) -> Any:
    """The value, if a program gave it.

    Raises:
        ValueError: it comes from a scene file.
    """
    if isinstance(value, Held):
        return value
    raise ValueError(
        'objects are given in Python, `flexfmu.run(scene, controllers=[...])`; in a scene file use kind = "python"'
    )


class ObjectSection(LoopSection):
    """An object of the caller's program: a function with `flexfmu.controller`, a block, a slave, a python-control system, a shaper.

    Scene files can't have it. A scene with one runs in every way; it is written with the object's type and address alone.
    `arguments` are parameters of a function that differ from its defaults.
    """

    kind: Literal["object"]
    arguments: dict[str, Any] = Field(default_factory=dict)
    object: Annotated[Any, BeforeValidator(_held), PlainSerializer(repr, return_type=str, when_used="json")]

    @model_validator(mode="after")
    def _knows_its_arguments(self) -> Self:
        if self.arguments:
            if not hasattr(self.object.value, "changed"):
                raise ValueError(f"`arguments` are those of a function, {self.object!r} has none: leave them out")
            self.object.value.changed(self.arguments)
        return self


FILE_TYPES = (str, int, float, bool, list, dict, date, time)
"""Types of the values in a scene file."""


def as_parts(value: Any) -> Any:
    """The parts of a list as a tuple: sections and tables as they are, objects of the caller's program in sections of their own."""
    if not isinstance(value, (list, tuple)):
        return value
    return tuple(each if isinstance(each, (Section, *FILE_TYPES)) else _object_table(each) for each in value)


def _object_table(value: Any) -> dict[str, Any]:
    """The section of an object; functions with parameters have their own names, for keys such as ``mine.arguments.gain``."""
    name = value.name if hasattr(value, "changed") and value.name not in RESERVED else None
    return {"kind": "object", "object": Held(value), "name": name}


OwnPart = PythonSection | FmuSection | SkipJsonSchema[ObjectSection]
"""Parts of the loop that users bring, whatever their kind."""
