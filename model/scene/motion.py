"""The section `trajectory`: the path, its blends, and the motion along it; or a motion from a CSV file (`kind = "table"`)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeAlias

from pydantic import (
    AfterValidator,
    BeforeValidator,
    PrivateAttr,
    SerializationInfo,
    SerializerFunctionWrapHandler,
    create_model,
    model_serializer,
    model_validator,
)

from flexfmu.model.scene.loop import from_scene_file
from flexfmu.model.scene.mechanism import Length
from flexfmu.model.scene.section import Seconds, SecondsOrZero, Section, as_tuple, named_kind, quantity
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.path import BLENDS, PickAndPlacePath
from flexfmu.trajectories.profiles import PROFILES, Coefficients, Parameter

StartPoint = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("m")]
LiftDirection = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("1")]

PICK_AND_PLACE: Literal["pick-and-place"] = "pick-and-place"
"""Kind of a motion whose section has no `kind`."""


def with_kind(section: Any) -> Any:
    """The section with the kind that it has by default."""
    return {"kind": PICK_AND_PLACE, **section} if isinstance(section, dict) else section


class ProfileSection(Section):
    """Motion profile along the path: a kind of `PROFILES` with its parameters."""

    kind: str

    @property
    def parameters(self) -> dict[str, float | tuple[float, ...]]:
        """The values of the parameters by name."""
        return self.model_dump(exclude={"kind"}, exclude_none=True)

    @model_validator(mode="after")
    def _parameters_belong_to_the_kind(self) -> Self:
        # all parameters of this kind, and none of another kind
        own = PROFILES[self.kind].parameters
        for name, parameter in own.items():
            if name not in self.parameters:
                raise ValueError(f"`{name}` is missing: profile `{self.kind}` needs {parameter.expected(name)}")
        for name, value in self.parameters.items():
            if name not in own:
                owners = " or ".join(f"`{kind}`" for kind, profile in PROFILES.items() if name in profile.parameters)
                raise ValueError(f"`{name}` = {value} belongs to profile {owners} alone: remove it from `{self.kind}`")
        # what several values have to fulfil together
        try:
            PROFILES[self.kind].make(**self.parameters)
        except TrajectoryError as error:
            raise ValueError(str(error)) from None
        return self


def _field(parameter: Parameter | Coefficients) -> Any:
    """The type of a parameter's key."""
    if isinstance(parameter, Coefficients):
        return Annotated[tuple[float, ...], BeforeValidator(as_tuple), quantity("1", min_length=parameter.at_least)]
    return Annotated[float, quantity("1", gt=parameter.above, le=parameter.at_most)]


# kinds and keys follow from the tables, which a type checker can't evaluate
if TYPE_CHECKING:
    from flexfmu.trajectories.table import MotionTable

    BlendName: TypeAlias = str
    Profile: TypeAlias = ProfileSection
else:
    BlendName = Literal[tuple(BLENDS)]
    Profile = create_model(
        "Profile",
        __base__=ProfileSection,
        kind=(Literal[tuple(PROFILES)], ...),
        **{
            name: (_field(parameter) | None, None)
            for profile in PROFILES.values()
            for name, parameter in profile.parameters.items()
        },
    )


class BlendSection(Section):
    """Blends of the path's two corners: d = height along the lift, e = width along the crossing."""

    kind: BlendName
    height: Length
    width: Length


class ReferencesSection(Section):
    """References of the joints with which the end effector of the flexible robot follows the motion.

    They are splines with knots `knot_spacing` apart. Joints start 2 ms before the end effector and stop 2 ms after it.
    """

    kind: Literal["flexible"]
    knot_spacing: Seconds = 0.002


def _none_for_rigid(value: Any) -> Any:
    """None for references of the rigid robot, which are the usual ones."""
    return None if value in ("rigid", {"kind": "rigid"}) else named_kind(value)


class MotionSection(Section):
    """Any motion: how long it takes, the way back, the standstill after it, and for which robot the references are.

    With a way back it is a number of cycles: there, `pause`, the same motion reversed in time, `pause`, and so on.
    """

    duration: Seconds
    dwell: SecondsOrZero = 0.0
    way_back: Literal["none", "same-path"] = "none"
    cycles: Annotated[int, quantity("1", ge=1)] = 1
    pause: SecondsOrZero = 0.0
    references: Annotated[ReferencesSection | None, BeforeValidator(_none_for_rigid)] = None

    @property
    def moving_time(self) -> float:
        """Time from the start of the first motion to the end of the last one [s], pauses included, without shapers."""
        motions = 1 if self.way_back == "none" else 2 * self.cycles
        return motions * self.duration + (motions - 1) * self.pause

    @model_validator(mode="after")
    def _cycles_come_back(self) -> Self:
        for key, value, usual in (("cycles", self.cycles, 1), ("pause", self.pause, 0.0)):
            if self.way_back == "none" and value != usual:
                raise ValueError(f'`{key}` = {value:g} needs a way back: add `way_back = "same-path"`')
        if self.way_back != "none" and self.references is not None:
            raise ValueError(
                '`references = "flexible"` is for a single motion, its way back needs others: leave out `way_back`, or the '
                "references"
            )
        return self


class TrajectorySection(MotionSection):
    """The Adept half cycle: lift, crossing and lowering with blended corners, then a standstill of `dwell`."""

    kind: Literal["pick-and-place"] = PICK_AND_PLACE
    start: StartPoint
    lift: LiftDirection
    height: Length
    width: Length
    blend: BlendSection
    profile: Annotated[Profile, BeforeValidator(named_kind)]

    @property
    def path(self) -> PickAndPlacePath:
        """The path; equal ones share their table of arc lengths.

        Raises:
            TrajectoryError: blend and path don't fit.
        """
        corner = self.blend.kind, self.blend.height, self.blend.width
        return _path(self.start, self.lift, self.height, self.width, corner)

    @model_validator(mode="after")
    def _blends_fit(self) -> Self:
        if math.hypot(*self.lift) == 0.0:
            raise ValueError("`lift` must be a direction with a length above zero, got [0.0, 0.0]")
        if self.blend.height > self.height:
            raise ValueError(f"`blend.height` must be at most `height` = {self.height} m, got {self.blend.height} m")
        if self.blend.width > self.width / 2:
            raise ValueError(f"`blend.width` must be at most `width`/2 = {self.width / 2} m, got {self.blend.width} m")
        return self


@lru_cache(maxsize=64)
def _path(start: Point, lift: Point, height: float, width: float, corner: tuple[str, float, float]) -> PickAndPlacePath:
    """The path, cached."""
    kind, *extent = corner
    return PickAndPlacePath(start, lift, height, width, BLENDS[kind].make(*extent))


class TableSection(MotionSection):
    """A spline through the rows of a CSV file: times and positions, with or without derivatives; then a standstill of `dwell`.

    `file` is relative to the scene file's folder. `coordinates` is what to read if the file has both. `degree` is that of the
    spline, by default 5, with jerks 7. `noise` is the standard deviation of measured positions, [m] or [rad]: the spline passes
    them at that distance. `duration` makes the motion faster or slower; by default it is that of the file.
    """

    kind: Literal["table"]
    file: Annotated[str, AfterValidator(from_scene_file)]
    coordinates: Literal["end-effector", "joints"] | None = None
    degree: Literal[3, 5, 7] | None = None
    noise: Annotated[float | None, quantity("m or rad", gt=0.0)] = None
    duration: Seconds = 0.0
    _table: MotionTable = PrivateAttr()

    @model_validator(mode="after")
    def _read(self) -> Self:
        from flexfmu.trajectories.table import read_table  # which few scenes need

        self._table = read_table(self.file, self.coordinates)
        self._table.degree(self.degree, self.noise)
        if self.references is not None and self._table.coordinates == "joints":
            raise ValueError(
                f'`references = "flexible"` needs a motion of the end effector, but {self.file} is one of the joints, which are '
                "references already: leave out `references`"
            )
        if "duration" not in self.model_fields_set:
            self.__dict__["duration"] = self._table.duration
        return self

    @model_serializer(mode="wrap")
    def _without_the_duration_of_the_file(
        self, serialize: SerializerFunctionWrapHandler, info: SerializationInfo
    ) -> Any:
        data = serialize(self)
        # another file has another duration
        if info.mode == "python" and "duration" not in self.model_fields_set:
            data.pop("duration", None)
        return data

    @property
    def table(self) -> MotionTable:
        """Rows of the file."""
        return self._table
