"""The page that an FMU brings along, and its picture."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Callable
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest

from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.picture import plant_picture, png
from flexfmu.fmu_build.sources import generate_sources
from flexfmu.model.plants import build_model
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.trajectories.curves import Point


class _Page(HTMLParser):
    """Checks that elements are closed in order, and collects text and attributes that load or lead elsewhere."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(source)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]
        self.open += [tag] if tag not in {"meta", "br", "hr", "img", "input", "link"} else []

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(params=["motion", "torque"])
def robot(request: pytest.FixtureRequest) -> SymbolicModel:
    """Both plants of the paper's robot, with friction and elastic drives."""
    scene = load_scene("barnard2012-6kg")
    changes = {"cosimulation.drive": request.param, "effects.joint_friction.viscous": 0.1, "effects.distal_axial": 1}
    return build_model(scene.replace(changes))


def test_page_tells_all_effects_and_variables(robot: SymbolicModel) -> None:
    """Whoever gets the FMU alone learns what is in it, what each variable is in its unit and in that of drawings, and whose equations
    these are; it reads the same without a network: every element is closed, nothing is loaded."""
    source = generate_sources(robot, DefaultExperiment()).documentation["documentation/index.html"]
    page = _Page(source)
    assert (page.open, page.links) == ([], [])
    for effect in robot.effects:
        assert effect.title in page.text
        assert effect.sentence in page.text
        assert effect.contributes
    for variable in (*robot.inputs, *robot.parameters, *robot.outputs):
        assert variable.name in page.text
        assert variable.description in page.text
    assert "0.24 m = 240 mm" in unescape(source)
    # what the FMU does with a tolerance beyond its range
    assert f"between 0 and 1, anything else is an error; below {LEAST_TOLERANCE} it counts as" in source
    cited = [effect.sentence for effect in robot.effects if "eq" in effect.sentence]
    assert len(cited) == 2
    assert all("of Barnard, Briot and Caro (2012)" in sentence for sentence in cited)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"effects.basis": "assumed-modes"},
            {
                "link11.bending[2]": "2 of proximal link 1 (link11): the paper's second assumed mode, eq. (1)",
                "link22.bending[1]": "1 of distal link 2 (link22): first mode of a beam pinned at both ends",
                "link12.axial[1]": "1 of distal link 1 (link12): the paper's first assumed mode, eq. (2)",
            },
        ),
        (
            {"effects.basis": "craig-bampton"},
            {
                "link21.bending[1]": "1 of proximal link 2 (link21): Craig and Bampton's static shape under a force at the tip, as "
                "the tip's displacement",
                "link12.axial[2]": "2 of distal link 1 (link12): Craig and Bampton's first mode with the tip held",
            },
        ),
        (
            {"effects.basis": "craig-bampton", "effects.beam": "timoshenko", "mechanism.material.poissons_ratio": 0.33},
            {
                "link21.bending[2]": "2 of proximal link 2 (link21): Craig and Bampton's first mode with the tip held, with "
                "shear and rotary inertia"
            },
        ),
    ],
    ids=["assumed modes", "Craig-Bampton", "Timoshenko"],
)
def test_coordinates_say_which_shape_and_link_they_belong_to(
    changes: dict[str, object], expected: dict[str, str]
) -> None:
    """Each has a text of its own, with the shape's number, where it comes from, and the link in words."""
    modes = {f"effects.{family}": 2 for family in ("proximal_bending", "distal_bending", "distal_axial")}
    model = build_model(load_scene("barnard2012-6kg").replace(modes | changes))
    texts = {each.name: each.description for each in model.outputs if each.name.startswith("link") and "[" in each.name}
    assert {name: texts[name].partition(" coordinate ")[2] for name in expected} == expected
    assert len(set(texts.values())) == len(texts) == 12


def test_mechanism_is_drawn_to_scale(robot: SymbolicModel) -> None:
    """The links of the picture have the ratio of the scene's lengths, and meet at the joints."""
    lines = plant_picture(robot.drawing, 400, 300).lines
    lengths = [abs(complex(*line.end) - complex(*line.start)) for line in lines]
    assert lengths[1] / lengths[0] == pytest.approx(0.38079 / 0.24)
    assert lengths[3] / lengths[2] == pytest.approx(0.38079 / 0.24)
    assert lines[1].end == pytest.approx(lines[3].end)


@pytest.mark.parametrize(
    "pose",
    [
        {},
        {"trajectory.start": [0.0, 0.4]},
        {"mechanism.working_mode": "elbows-in", "mechanism.assembly_mode": "right"},
        {"mechanism.working_mode": "left"},
        {"mechanism.working_mode": "right"},
    ],
    ids=["as in the paper", "between the motors", "elbows in", "elbows to the left", "elbows to the right"],
)
def test_labels_can_be_read(pose: dict[str, object]) -> None:
    """Names lie within the picture and touch neither each other nor a bar or spot."""
    scene = load_scene("barnard2012-6kg").replace(pose)
    width, height = 560, 420
    picture = plant_picture(build_model(scene).drawing, width, height, labelled=True)
    boxes = {label.text: label.box for label in picture.labels}
    assert len(boxes) == 9
    for left, top, right, bottom in boxes.values():
        assert 0.0 < left < right < width
        assert 0.0 < top < bottom < height
    for one, other in itertools.combinations(boxes.values(), 2):
        assert max(other[0] - one[2], one[0] - other[2], other[1] - one[3], one[1] - other[3]) > 5.0
    drawn = [(line.start, line.end, line.width / 2) for line in picture.lines]
    drawn += [(disc.centre, disc.centre, disc.radius) for disc in picture.discs]
    for box in boxes.values():
        assert all(_distance(box, start, end) > radius for start, end, radius in drawn)


def _distance(box: tuple[float, float, float, float], start: Point, end: Point) -> float:
    """From a box to a line, in hundred points of it."""
    shares = np.linspace(0.0, 1.0, 101)[:, None]
    x, y = ((1.0 - shares) * start + shares * end).T
    across = np.maximum(np.maximum(box[0] - x, x - box[2]), 0.0)
    return float(np.hypot(across, np.maximum(np.maximum(box[1] - y, y - box[3]), 0.0)).min())


def test_names_cannot_break_the_page(make_oscillators: Callable[..., SymbolicModel]) -> None:
    """A model's own words are text, whatever signs they have."""
    pages = generate_sources(make_oscillators(), DefaultExperiment()).documentation
    page = _Page(pages["documentation/index.html"])
    assert '"linear" & undamped' in page.text


def test_icon_is_a_sound_png(robot: SymbolicModel) -> None:
    """Signature, size, checksums and as many pixels as it says; links in colour on a transparent ground."""
    image = png(plant_picture(robot.drawing))
    assert image.startswith(b"\x89PNG\r\n\x1a\n")
    chunks, at = {}, 8
    while at < len(image):
        length, kind = struct.unpack(">I4s", image[at : at + 8])
        chunks[kind] = image[at + 8 : at + 8 + length]
        assert struct.unpack(">I", image[at + 8 + length : at + 12 + length]) == (zlib.crc32(kind + chunks[kind]),)
        at += 12 + length
    width, height = struct.unpack(">II", chunks[b"IHDR"][:8])
    pixels = zlib.decompress(chunks[b"IDAT"])
    assert (width, height, len(pixels)) == (96, 96, 96 * (1 + 4 * 96))
    opacities = {pixels[row * 385 + 1 + 4 * column + 3] for row in range(96) for column in range(96)}
    assert {0, 255} <= opacities
