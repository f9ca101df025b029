"""The result of `flexfmu paper`: tables beside the printed ones, and figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from flexfmu.cosim.paper.agreement import Agreement, count_agreement
from flexfmu.cosim.paper.comparison import ComparisonTable
from flexfmu.cosim.paper.layout import lay_out
from flexfmu.cosim.paper.markdown import table_to_markdown
from flexfmu.cosim.paper.reference import Source


@dataclass(frozen=True)
class Figure:
    """A drawn figure.

    Attributes:
        key: file name without suffix, for example ``figure-06``.
        label, caption: for example ``Figure 6`` and one sentence.
        folder: folder of its files within the report's folder; empty for that folder itself.
    """

    key: str
    label: str
    caption: str
    folder: str = "figures"

    def file(self, suffix: str) -> str:
        """Path of the figure's file within the report's folder; ``suffix`` is ``.png`` or ``.svg``."""
        return f"{self.folder}/{self.key}{suffix}" if self.folder else f"{self.key}{suffix}"


@dataclass(frozen=True)
class PaperReport:
    """What has been computed, which may be a part of it while the command is running.

    Attributes:
        source: the paper.
        tables: comparisons in the order of the report.
        figures: the figures drawn, in the order of the report.
        overview: one picture that sums it up.
        timing: wall-clock time of the parts in seconds.
        versions: what it was computed with: packages, platform, compiler; None where unknown.
    """

    source: Source
    tables: tuple[ComparisonTable, ...] = ()
    figures: tuple[Figure, ...] = ()
    overview: Figure | None = None
    timing: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str | None] = field(default_factory=dict)

    def table(self, key: str) -> ComparisonTable:
        """A table by the key of its data file, for example ``table-07``.

        Raises:
            KeyError: it has not been computed.
        """
        for table in self.tables:
            if table.printed.key == key:
                return table
        raise KeyError(key)

    @property
    def agreement(self) -> Agreement:
        """The agreement over all tables."""
        return count_agreement(cell for table in self.tables for cell in table.cells)

    def summary(self) -> str:
        """The agreement over all tables in one sentence."""
        return f"All tables: {self.agreement.sentence()}"

    def to_markdown(self) -> str:
        """The whole report; figures are referred to by their relative paths."""
        head = ["# The paper's experiment, printed and computed", f"Printed figures: {self.source.citation}."]
        remarks = "\n".join(f"- {remark}" for remark in self.source.remarks)
        tables = [table_to_markdown(lay_out(table)) for table in self.tables]
        figures = [f"![{figure.label}. {figure.caption}]({figure.file('.png')})" for figure in self.figures]
        return "\n\n".join([*head, remarks, f"**{self.summary()}**", *tables, *figures]).rstrip() + "\n"

    def to_json(self) -> str:
        """The whole report for machines; figures in the unit of their quantity."""
        return json.dumps(self.to_dict(), ensure_ascii=False, indent=2, allow_nan=False) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """The whole report as plain data."""
        return {
            "source": {"citation": self.source.citation, "doi": self.source.doi, "url": self.source.url},
            "remarks": list(self.source.remarks),
            "agreement": self.agreement.to_dict(),
            "tables": [table.to_dict() for table in self.tables],
            "figures": [{"key": f.key, "label": f.label, "caption": f.caption} for f in self.figures],
            "timing": dict(self.timing),
            "versions": dict(self.versions),
        }
