"""Objects as a user sees them: a few lines on a terminal, a table in a notebook; and the progress of what takes long."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO
from math import pi
from textwrap import wrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ShowProgress = Callable[[str, float | None], None]
"""Called with the current activity and the finished fraction, 0..1; None where it isn't known."""


def quiet(text: str, fraction: float | None) -> None:
    """Show no progress."""


WIDTH = 79
"""Columns of a line; the narrowest terminals have 80."""

PIXELS = 90
"""Of a picture in a notebook, for an inch."""


def few_lines(head: str, items: Sequence[str], lines: int = 4) -> str:
    """Return a line and below it the items in at most this many lines; where not all fit, the last line counts the others."""
    if not items:
        return shorten(head, WIDTH)
    # no line has more items than this
    shown = min(len(items), lines * WIDTH // 3)
    while True:
        rest = "" if shown == len(items) else f", … {len(items) - shown} more"
        # spaces within an item don't break it
        text = ", ".join(item.replace(" ", "\0") for item in items[:shown]) + rest
        found = wrap(
            text, WIDTH, initial_indent="  ", subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
        if len(found) <= lines or shown == 1:
            return "\n".join([shorten(head, WIDTH), *found]).replace("\0", " ")
        shown -= 1


def shorten(text: str, most: int) -> str:
    """Return a text in one line of at most this many characters; what is cut off is an ellipsis."""
    line = " ".join(text.split())
    return line if len(line) <= most else line[: most - 1].rstrip() + "…"


UNITS: Mapping[str, tuple[str, float]] = {
    name: (unit, factor)
    for unit, factors in {
        "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
        "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6},
        "m/s": {"m/s": 1.0, "mm/s": 1e-3},
        "m/s2": {"m/s2": 1.0, "m/s²": 1.0, "m/s^2": 1.0, "g": 9.80665},
        "rad": {"rad": 1.0, "mrad": 1e-3, "deg": pi / 180.0, "°": pi / 180.0},
        "rad/s": {"rad/s": 1.0, "deg/s": pi / 180.0, "°/s": pi / 180.0, "rpm": pi / 30.0, "1/min": pi / 30.0},
        "rad/s2": {"rad/s2": 1.0, "rad/s²": 1.0, "deg/s2": pi / 180.0},
        "N": {"N": 1.0, "kN": 1e3},
        "N.m": {
            **dict.fromkeys(("N.m", "N·m", "Nm", "N*m"), 1.0),
            **dict.fromkeys(("mN.m", "mN·m", "mNm"), 1e-3),
            **dict.fromkeys(("kN.m", "kN·m", "kNm"), 1e3),
        },
        "W": {"W": 1.0, "kW": 1e3},
        "J": {"J": 1.0, "kJ": 1e3},
    }.items()
    for name, factor in factors.items()
}
"""Unit as people write it in conditions and in logs → SI unit as files have it, and factor to that."""

SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def shown_unit(unit: str) -> str:
    """Return a unit as people read it, from its name in files: ``N·m`` of ``N.m``, ``m/s²`` of ``m/s2``, nothing of ``1``."""
    powers = re.sub(r"(?<=[a-zA-Z])\d+", lambda digits: digits[0].translate(SUPERSCRIPTS), unit.replace(".", "·"))
    return "" if unit == "1" else powers


def html_picture(figure: Figure) -> str:
    """Return a figure as an image in HTML."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=PIXELS)
    return f'<img alt="" style="max-width: 100%" src="data:image/png;base64,{b64encode(content.getvalue()).decode()}">'


def html_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in HTML for a notebook; all cells are texts."""
    from html import escape

    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
