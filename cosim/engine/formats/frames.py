"""Signals as a pandas data frame."""

from __future__ import annotations

from collections.abc import Mapping

import pandas

from flexfmu.cosim.engine.columns import Column
from flexfmu.cosim.engine.slave import RealArray


def data_frame(time: RealArray, columns: Mapping[str, Column]) -> pandas.DataFrame:
    """Return signals as columns over the index ``time`` [s], with their units in ``attrs["units"]``.

    Args:
        time: (N,) instants [s].
        columns: name → signal; signals of type String become columns of texts.
    """
    frame = pandas.DataFrame(
        {name: column.listed() for name, column in columns.items()}, index=pandas.Index(time, name="time")
    )
    frame.attrs["units"] = {"time": "s", **{name: column.unit for name, column in columns.items()}}
    return frame
