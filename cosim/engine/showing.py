"""Objects as a user sees them: a few lines on a terminal, a table in a notebook; and the progress of what takes long."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from io import BytesIO
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
