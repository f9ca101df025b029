"""How many of the printed figures are reproduced, and how closely."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from flexfmu.cosim.paper.comparison import Cell

BOUNDS = (0.001, 0.005, 0.01, 0.035, 0.10)
"""Relative errors within which cells are counted: 0.1 %, 0.5 %, 1 %, 3.5 % and 10 %."""


@dataclass(frozen=True)
class Agreement:
    """Count of the cells whose relative error stays within each of `BOUNDS`.

    Attributes:
        compared: number of cells whose printed figure can be right.
        within: number of these within each bound.
        to_the_digits: number of these equal to the printed figure when rounded like it.
        misprinted: number of further cells whose printed figure can't be right.
    """

    compared: int
    within: tuple[int, ...]
    to_the_digits: int
    misprinted: int

    def sentence(self) -> str:
        """The counts in one sentence."""
        if not self.compared:
            return f"{_cells(self.misprinted)} misprinted."
        more = f"; {_cells(self.misprinted)} misprinted and not counted" if self.misprinted else ""
        return f"{self._counts()}{more}."

    def _counts(self) -> str:
        steps = [
            f"{count} within {100 * bound:g} %"
            for previous, count, bound in zip((0, *self.within), self.within, BOUNDS, strict=False)
            if count > previous
        ]
        steps = steps or ["none within 10 %"]
        return f"Of {self.compared} cells, {', '.join(steps)} ({self.to_the_digits} to the printed digits)"

    def to_dict(self) -> dict[str, Any]:
        """The counts for JSON."""
        return {
            "compared": self.compared,
            "within": {f"{bound:g}": count for bound, count in zip(BOUNDS, self.within, strict=True)},
            "to_the_digits": self.to_the_digits,
            "misprinted": self.misprinted,
        }


def count_agreement(cells: Iterable[Cell]) -> Agreement:
    """Count how closely cells agree; cells whose printed figure can't be right are only counted as such."""
    cells = tuple(cells)
    believable = [cell for cell in cells if cell.believable]
    return Agreement(
        compared=len(believable),
        within=tuple(sum(abs(cell.relative_error) <= bound for cell in believable) for bound in BOUNDS),
        to_the_digits=sum(cell.agrees_to_the_digits for cell in believable),
        misprinted=len(cells) - len(believable),
    )


def _cells(count: int) -> str:
    return "1 cell is" if count == 1 else f"{count} cells are"
