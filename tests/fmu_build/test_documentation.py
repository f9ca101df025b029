"""The page that an FMU brings along, and its picture."""

from __future__ import annotations

from collections.abc import Callable
from html import unescape
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import pytest
from matplotlib.image import imread

from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.picture import plant_picture
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.templating import render
from flexfmu.model.plants import build_model
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicModel


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


SHAPES = {
    "assumed-modes": """
        link11.bending[2]: 2 of proximal link 1 (link11): the paper's second assumed mode, eq. (1)
        link22.bending[1]: 1 of distal link 2 (link22): first mode of a beam pinned at both ends
        link12.axial[1]: 1 of distal link 1 (link12): the paper's first assumed mode, eq. (2)""",
    "craig-bampton": """
        link21.bending[1]: 1 of proximal link 2 (link21): Craig and Bampton's static shape under a force at the tip, as the tip's displacement
        link12.axial[2]: 2 of distal link 1 (link12): Craig and Bampton's first mode with the tip held""",
}
"""Basis → name and description of some coordinates."""


@pytest.mark.parametrize("basis", SHAPES)
def test_coordinates_say_which_shape_and_link_they_belong_to(basis: str) -> None:
    """Each has a text of its own, with the shape's number, where it comes from, and the link in words."""
    modes = {f"effects.{family}": 2 for family in ("proximal_bending", "distal_bending", "distal_axial")}
    model = build_model(load_scene("barnard2012-6kg").replace(modes | {"effects.basis": basis}))
    texts = {each.name: each.description for each in model.outputs if each.name.startswith("link") and "[" in each.name}
    for line in SHAPES[basis].strip().splitlines():
        name, _, text = line.strip().partition(": ")
        assert texts[name].partition(" coordinate ")[2] == text
    assert len(set(texts.values())) == len(texts) == 12


def test_mechanism_is_drawn_to_scale(robot: SymbolicModel) -> None:
    """The links of the picture have the ratio of the scene's lengths, and meet at the joints; each part has its name."""
    picture = plant_picture(robot.drawing)
    lines = picture.lines
    lengths = [abs(complex(*line.end) - complex(*line.start)) for line in lines]
    assert lengths[1] / lengths[0] == pytest.approx(0.38079 / 0.24)
    assert lengths[3] / lengths[2] == pytest.approx(0.38079 / 0.24)
    assert lines[1].end == pytest.approx(lines[3].end)
    assert len({label.text for label in picture.labels}) == len({label.at for label in picture.labels}) == 9


def test_fmus_carry_the_licence_of_the_project() -> None:
    """The licence inside an FMU is the project's own, word for word."""
    licence = Path(__file__).parents[2] / "LICENSE"
    if not licence.is_file():
        pytest.skip("tests run away from the source tree")
    assert render("license.txt") == licence.read_text(encoding="utf-8")


def test_names_cannot_break_the_page(make_oscillators: Callable[..., SymbolicModel]) -> None:
    """A model's own words are text, whatever signs they have."""
    pages = generate_sources(make_oscillators(), DefaultExperiment()).documentation
    page = _Page(pages["documentation/index.html"])
    assert '"linear" & undamped' in page.text


def test_icon_is_a_sound_png(robot: SymbolicModel) -> None:
    """A reader of PNG finds links in colour on a transparent ground."""
    image = imread(BytesIO(generate_sources(robot, DefaultExperiment()).archive_files()["model.png"]))
    assert image.shape == (96, 96, 4)
    assert {0.0, 1.0} <= {*image[..., 3].ravel()}
