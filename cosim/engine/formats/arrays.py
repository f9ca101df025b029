"""Signals as an xarray data set."""

from __future__ import annotations

from collections.abc import Mapping

import xarray

from flexfmu.cosim.engine.columns import Column
from flexfmu.cosim.engine.slave import RealArray


def data_set(time: RealArray, columns: Mapping[str, Column]) -> xarray.Dataset:
    """Return signals as variables over the coordinate ``time`` [s], each with its unit in ``attrs["units"]``.

    Args:
        time: (N,) instants [s].
        columns: name → signal; signals of type String become variables of texts.
    """
    variables = {name: ("time", column.listed(), {"units": column.unit}) for name, column in columns.items()}
    return xarray.Dataset(variables, coords={"time": ("time", time, {"units": "s"})})
