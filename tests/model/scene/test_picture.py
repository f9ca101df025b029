"""A scene shows itself in a notebook: its sections, and mechanism and path to scale."""

from __future__ import annotations

import re
from base64 import b64decode
from math import dist
from pathlib import Path
from xml.etree import ElementTree

import pytest

from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


def drawn(scene: Scene) -> tuple[str, list[list[tuple[float, float]]], tuple[float, float]]:
    """HTML, polylines of the picture, and its size [px]."""
    html = scene._repr_html_()
    found = re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', html)
    assert found is not None
    root = ElementTree.fromstring(b64decode(found[1]))
    lines = [each.attrib["points"] for each in root.iter("{http://www.w3.org/2000/svg}polyline")]
    points = [[(float(x), float(y)) for x, y in (pair.split(",") for pair in line.split())] for line in lines]
    return html, points, (float(root.attrib["width"]), float(root.attrib["height"]))


@pytest.mark.parametrize("changes", [
    {},
    {"mechanism.working_mode": "left", "mechanism.assembly_mode": "left"},
    {"trajectory.lift": [1.0, 0.0], "trajectory.start": [0.0, 0.3], "trajectory.width": 0.2},
])  # fmt: skip
def test_mechanism_and_path_are_to_scale_and_within(changes: dict[str, object]) -> None:
    """Links have their lengths, at one scale, at three poses; all of it is within the picture."""
    scene = load_scene("barnard2012-6kg").replace(changes)
    html, (path, *chains), (width, height) = drawn(scene)
    assert all(0.0 < x < width and 0.0 < y < height for line in (path, *chains) for x, y in line)
    assert height < 500.0
    assert len(chains) == 9
    for first, second, distal in zip(chains[::3], chains[1::3], chains[2::3], strict=True):
        scales = [
            dist(*first) / 0.24,
            dist(*second) / 0.24,
            *(dist(*pair) / 0.38079 for pair in (distal[:2], distal[1:])),
        ]
        assert scales == pytest.approx([scales[0]] * 4, abs=1.0)
        assert dist(distal[1], min(path, key=lambda point, to=distal[1]: dist(point, to))) < 0.2  # type: ignore[misc]
    for key in ("mechanism", "payload", "trajectory"):
        assert f">{key}</th>" in html


def test_tables_and_unreachable_points_are_drawn_too(tmp_path: Path) -> None:
    """A motion from a file that leads beyond the workspace is drawn as far as it goes."""
    (tmp_path / "way.csv").write_text("time,x,y\n0,-0.1,0.3\n0.2,0.0,0.3\n0.4,0.1,0.3\n0.5,0.1,2.0\n", encoding="utf-8")
    scene = load_scene("barnard2012-6kg").replace(
        {"trajectory": {"kind": "table", "file": str(tmp_path / "way.csv"), "dwell": 0.1}}
    )
    _, (path, *chains), _ = drawn(scene)
    assert len(path) == 4
    assert len(chains) == 6  # none at the last row
