"""The section `trajectory` with `kind = "table"`: a motion from a CSV file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    PrivateAttr,
    SerializationInfo,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from flexfmu.model.scene.loop import from_scene_file
from flexfmu.model.scene.motion import MotionSection
from flexfmu.model.scene.section import Seconds, quantity

if TYPE_CHECKING:
    from flexfmu.trajectories.table import MotionTable


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
        from flexfmu.trajectories.table_file import read_table  # which few scenes need

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
