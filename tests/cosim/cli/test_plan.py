"""`flexfmu plan`: what it writes and prints, wrong wishes, Ctrl-C, and narrow terminals."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path

import pytest
from command_line import flexfmu as command
from rich.console import Console

import flexfmu
from flexfmu.cosim.cli.design import _shown_plan
from flexfmu.cosim.design.plans import planner
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.plan_result import PlanResult
from flexfmu.cosim.design.plans.planner import plan_scene
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.model.scene.file import load_scene

SCENE = "barnard2012-6kg"
FEW = ("--set", "effects.proximal_bending=1", "--set", "effects.distal_axial=1")
QUICK = (*FEW, "--payload-band", "0", "--method", "search", "--no-robust")


def search(judge: Judge, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate]:
    """A slow motion without vibration, and one that is too fast; then Ctrl-C if the seed is 1."""
    for duration in (0.6, 0.35):
        keys = {"trajectory.duration": duration, "shaper": [{"kind": "zvd", "mode_count": 2}]}
        yield Candidate(f"shaped {duration:g}", "search", judge.goals.scene.replace(keys))
        if judge.goals.wishes.seed == 1:
            raise KeyboardInterrupt


@pytest.fixture(autouse=True)
def _quick_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "METHODS", dict.fromkeys(planner.METHODS, search))


@pytest.mark.slow
def test_the_planned_scene_the_front_and_the_page_are_written(tmp_path: Path) -> None:
    """What is printed, the scene in both places, and all figures in plan.json."""
    elsewhere, out = tmp_path / "my robot" / "mine.toml", tmp_path / "out"
    result = command(
        "plan", SCENE, *QUICK, "--limit", "off_path=0.05", "--margin", "0.002", "--out", str(out), "-o", str(elsewhere)
    )
    assert result.exit_code == 0, result.output
    assert {path.name for path in out.iterdir()} == {"planned.toml", "front.csv", "plan.json", "plan.html"}
    assert all(text in result.stdout for text in ("shaped 0.6", "kept, chosen", "All limits are kept"))
    assert load_scene(elsewhere) == load_scene(out / "planned.toml")
    assert flexfmu.reference_motion(load_scene(elsewhere)).duration == 0.6
    chosen = json.loads((out / "plan.json").read_text(encoding="utf-8"))["chosen"]
    assert chosen["motion"] == "shaped 0.6"
    names = {each["name"] for each in chosen["limits"]}
    assert names >= {"residual", "clearance", "torque ratio", "jerk ratio"}


@pytest.mark.slow
def test_the_planned_motion_simulates_in_its_page(tmp_path: Path) -> None:
    """live.html has the run of the planned motion; there is no other file."""
    pytest.importorskip("ziglang")
    wishes = ("--limit", "off_path=0.05", "--margin", "0.002", "--live")
    result = command("plan", SCENE, *QUICK, *wishes, "--out", str(tmp_path))
    assert result.exit_code == 0, result.output
    assert {path.name for path in tmp_path.iterdir()} >= {"plan.html", "live.html"}
    page = (tmp_path / "live.html").read_text(encoding="utf-8")
    assert '<section id="live"' in page
    assert len(page) < 1_000_000
    # what is copied from it is the planned scene
    packed = page.partition('id="module">')[2].partition("<")[0]
    head = json.loads(gzip.decompress(base64.b64decode(packed)).partition(b"\n")[0])
    run = head["runs"][0]
    assert run["origin"] == str(tmp_path / "planned.toml")
    assert run["settings"] == []
    assert run["scene"]["name"] == f"{SCENE}-planned"
    assert run["scene"]["trajectory"]["duration"] == 0.6
    assert f"<h1>{SCENE}-planned" in page


@pytest.mark.slow
def test_ctrl_c_writes_the_best_so_far(tmp_path: Path) -> None:
    """The motion found until then is printed and written."""
    result = command("plan", SCENE, *QUICK, "--seed", "1", "--out", str(tmp_path))
    assert "interrupted: this is the best motion so far" in result.stderr
    assert "shaped 0.6" in result.stdout
    assert flexfmu.reference_motion(load_scene(tmp_path / "planned.toml")).duration == 0.6


@pytest.mark.slow
def test_what_no_motion_reaches_is_a_sentence_and_status_1(tmp_path: Path) -> None:
    """It names the limit that the nearest motion misses."""
    result = command("plan", SCENE, *QUICK, "--residual", "1e-15", "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "No motion found keeps all limits; the nearest misses residual" in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--minimise", "energy"), "needs `duration`"),
        (("--duration", "0.3"), "contradict each other"),
        (("--minimise", "comfort"), "minimise"),
        (("--payload-band", "wide"), "a payload band is a fraction"),
        (("--payload-band", "8,4"), "lightest and the heaviest"),
        (("--limit", "torque"), "--limit takes NAME=VALUE"),
        (("--limit", "torqe=80"), "torque"),
        (("--limit", "torque=1"), "against gravity"),
        (("--method", "genetic"), "unknown method genetic"),
        (("--output", "planned.csv"), "a scene file ends in .toml"),
        (("--margin", "-1"), "margin"),
        (("--limit", "torque=0.1x"), "against gravity"),
        (("--counts", "1048576"), "--counts belongs to --export"),
        (("--rate", "4000"), "--rate belongs to --export"),
        (("--export", "drive.csv", "--unit", "turn", "--counts", "4096"), "leave one out"),
        (("--export", "drive.txt"), "a drive's table ends in .csv, got drive.txt"),
        (("--export", "/dev/null/drive.csv"), "a drive's table can't be written"),
        (("--output", "/dev/null/planned.toml"), "a scene file can't be written"),
        (("--pause", "0.1", "--method", "search"), "a cycle is planned by optimal control alone"),
        (("--front", "time,power", "--method", "search"), "`plan.front` is found by optimal control"),
    ],
)
def test_a_wrong_wish_is_one_line(options: tuple[str, ...], message: str, tmp_path: Path) -> None:
    """Each says what would be right, without a traceback; nothing is left that another plan in the same folder would meet."""
    result = command("plan", SCENE, *FEW, *options, "--out", str(tmp_path / "out"))
    text = result.stderr + (str(result.exception) if result.exception else "")
    assert result.exit_code == 2
    assert message in " ".join(text.split())
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_table_that_swings_more_than_wished_is_a_miss(tmp_path: Path) -> None:
    """The motion keeps all limits, its coarse counts don't, or no robot can follow them: a sentence with the remedy, and status 1."""
    wishes = ("--limit", "off_path=0.05", "--margin", "0.002", "--export", str(tmp_path / "drive.csv"))
    for counts, status in (("1", 1), ("4096", 1), ("16777216", 0)):
        result = command("plan", SCENE, *QUICK, *wishes, "--counts", counts, "--out", str(tmp_path / "out"))
        text = " ".join(result.stdout.split())
        assert result.exit_code == status, text
        assert "All limits are kept" in text
        assert ("instead of 1 µm of residual vibration" in text) is (counts == "4096")
        assert ("the robot can't follow them" in text) is (counts == "1")
        assert ("raise --rate or --counts" in text) is bool(status)
        drive = json.loads((tmp_path / "out" / "plan.json").read_text())["drive"]
        assert (drive["unit"], drive["met"]) == ("count", not status)


@pytest.fixture(scope="module")
def found() -> PlanResult:
    """A plan with a long label."""
    scene = load_scene(SCENE).replace(
        {"effects.proximal_bending": 1, "effects.distal_axial": 1, "plan.payload_band": 0.0}
    )
    slow = scene.replace({"trajectory.duration": 0.6, "trajectory.dwell": 0.25})
    label = "lame 93 x 26 mm, polynomial, zvdd on joints x zvd on joints"
    return plan_scene(scene, methods=(), candidates=[Candidate(label, "search", slow)], robust=False)


@pytest.mark.slow
@pytest.mark.parametrize("columns", [40, 60, 80, 120])
def test_tables_fit_the_terminal(found: PlanResult, columns: int) -> None:
    """No line is longer than the terminal, and every number is whole."""
    console = Console(file=StringIO(), width=columns)
    for part in _shown_plan(found):
        console.print(part)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert max(map(len, text.splitlines())) <= columns
    for each in found.front:
        assert f"{each.time:.4g}" in text
        assert f"{1e6 * each.residual:.4g}" in text
    # a table, not blocks of lines
    assert ("Time [s]: " in text) is (columns < 60)
