"""Results with rows: the same figures as a data frame, CSV, JSON and in a notebook."""

from __future__ import annotations

import json
from math import nan
from typing import Any

from flexfmu.cosim.engine.rows import Rows


class Runs(Rows):
    """Two runs."""

    row_name = "run"

    def rows(self) -> list[dict[str, Any]]:
        """One of them without a figure."""
        return [{"run": "a", "torque": 1.5}, {"run": "b", "torque": nan}]

    def row_units(self) -> dict[str, str]:
        """Of the only figure."""
        return {"torque": "N.m"}


def test_rows_are_told_in_every_form() -> None:
    """JSON has no NaN; units are where there is room for them."""
    found = Runs()
    frame = found.to_pandas()
    assert (frame.index.name, frame.attrs["units"]) == ("run", {"torque": "N.m"})
    assert frame.loc["a", "torque"] == 1.5
    assert json.loads(found.to_json()) == [{"run": "a", "torque": 1.5}, {"run": "b", "torque": None}]
    assert found.to_csv().splitlines() == ["run,torque", "a,1.5", "b,nan"]
    html = found._repr_html_()
    assert "<th>torque [N·m]</th>" in html
    assert "<td>1.5</td>" in html
