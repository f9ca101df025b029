"""The picture of a scene in a notebook: the rigid mechanism at start, middle and end of its path, to scale, as SVG."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from contextlib import suppress
from html import escape
from typing import TYPE_CHECKING

from flexfmu.model.scene.assembly import bases, elbows
from flexfmu.model.scene.mechanism import Mechanism

if TYPE_CHECKING:
    from flexfmu.trajectories.curves import Point

WIDTH, TALLEST, MARGIN = 460.0, 394.0, 26.0
"""Width, largest height, and free space at each side [px]."""

OPACITIES = (1.0, 0.25, 0.5)
"""Of the mechanism at start, middle and end."""

INK, LINK, PATH, GREY = "#22303c", "#0b5fa5", "#c7394f", "#7b8794"


def scene_picture(mechanism: Mechanism, path: Sequence[Point]) -> str:
    """An SVG document: the path, the mechanism at its first, middle and last point, and the motors.

    Args:
        mechanism: the mechanism.
        path: points of the end effector [m]; where a leg can't reach one, the mechanism isn't drawn there.
    """
    chains: list[tuple[float, list[Point]]] = []
    for point, opacity in zip((path[0], path[len(path) // 2], path[-1]), OPACITIES, strict=True):
        with suppress(ValueError):
            first, second = elbows(mechanism, point)
            left, right = bases(mechanism)
            chains.append((opacity, [left, first, point, second, right]))
    # all points within the picture, to scale
    points = [*path, *bases(mechanism), *(each for _, chain in chains for each in chain)]
    (x0, x1), (y0, y1) = ((min(values), max(values)) for values in zip(*points, strict=True))
    scale = min((WIDTH - 2 * MARGIN) / (x1 - x0), (TALLEST - 2 * MARGIN) / max(y1 - y0, 1e-9))
    height = scale * (y1 - y0) + 2 * MARGIN

    def at(point: Point) -> str:
        x = 0.5 * WIDTH + scale * (point[0] - 0.5 * (x0 + x1))
        return f"{x:.1f},{MARGIN + scale * (y1 - point[1]):.1f}"

    def line(some: Iterable[Point], colour: str, width: float, opacity: float) -> str:
        style = f'fill="none" stroke="{colour}" stroke-width="{width}" stroke-opacity="{opacity}"'
        return f'<polyline points="{" ".join(map(at, some))}" {style} stroke-linecap="round" stroke-linejoin="round"/>'

    def disc(point: Point, colour: str, radius: float, opacity: float) -> str:
        x, y = at(point).split(",")
        return f'<circle cx="{x}" cy="{y}" r="{radius}" fill="{colour}" fill-opacity="{opacity}"/>'

    parts = [line(path, PATH, 2.0, 0.7)]
    for opacity, chain in chains:
        parts += [line(chain[:2], INK, 4.0, opacity), line(chain[3:], INK, 4.0, opacity)]
        parts.append(line(chain[1:4], LINK, 2.5, opacity))
        parts += [disc(elbow, INK, 3.5, opacity) for elbow in chain[1:4:2]]
        parts.append(disc(chain[2], PATH, 4.5, max(opacity, 0.6)))
    parts += [disc(base, GREY, 7.0, 1.0) for base in bases(mechanism)]
    size = f'width="{WIDTH:g}" height="{height:.0f}" viewBox="0 0 {WIDTH:g} {height:.0f}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
    return "".join([head, '<rect width="100%" height="100%" fill="white"/>', *parts, "</svg>"])


def scene_html(title: str, sections: Iterable[tuple[str, str]], picture: str) -> str:
    """A table of sections and the picture beside it, as HTML."""
    rows = "".join(
        f'<tr><th style="text-align: left; vertical-align: top">{escape(key)}</th><td style="text-align: left">{escape(text)}</td></tr>'
        for key, text in sections
    )
    source = f"data:image/svg+xml;base64,{b64encode(picture.encode()).decode()}"
    image = f'<img alt="mechanism and path of {escape(title)}" style="max-width: 100%" src="{source}">'
    return f"<p><b>{escape(title)}</b></p><table><tbody>{rows}</tbody></table>{image}"
