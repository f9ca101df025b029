"""A picture as a PNG file, for tools that show an FMU by its icon ``model.png``; no drawing library is needed."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from flexfmu.fmu_build.picture import Picture
from flexfmu.model.symbolic import Point

ICON_FILE = "model.png"
"""Where the standard wants it."""

ICON_SIZE = 96
"""Pixels in each direction."""

Array = NDArray[np.float64]


def png(picture: Picture) -> bytes:
    """The picture without its labels, on a transparent ground, edges smoothed over a pixel."""
    image = np.zeros((picture.height, picture.width, 4))
    for line in picture.lines:
        _paint(image, _distance(image, line.start, line.end) - line.width / 2, line.colour)
    for disc in picture.discs:
        _paint(image, _distance(image, disc.centre, disc.centre) - disc.radius, disc.colour)
    return _encode(np.rint(255 * image).astype(np.uint8))


def _distance(image: Array, start: Point, end: Point) -> Array:
    """Distance of each pixel's centre from a straight line between two points."""
    y, x = np.indices(image.shape[:2]) + 0.5
    along = np.subtract(end, start)
    offset = np.stack([x - start[0], y - start[1]], axis=-1)
    square = float(along @ along)
    fraction = np.clip(offset @ along / square, 0.0, 1.0) if square else np.zeros_like(x)
    return np.asarray(np.linalg.norm(offset - fraction[..., None] * along, axis=-1))


def _paint(image: Array, outside: Array, colour: str) -> None:
    """Lay a colour over the image where the signed distance ``outside`` is negative."""
    cover = np.clip(0.5 - outside, 0.0, 1.0)[..., None]
    ink = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    opacity = cover + image[..., 3:] * (1.0 - cover)
    mixed = cover * ink + image[..., :3] * image[..., 3:] * (1.0 - cover)
    image[..., :3] = np.divide(mixed, opacity, out=np.zeros_like(mixed), where=opacity > 0.0)
    image[..., 3:] = opacity


def _encode(pixels: NDArray[np.uint8]) -> bytes:
    """RGBA pixels (rows, columns, 4) as a PNG file (ISO/IEC 15948), without times and other extras."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, content) for kind, content in chunks)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
