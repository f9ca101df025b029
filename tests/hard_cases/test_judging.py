"""Every hard case goes well, with the checks of `flexfmu workprec --hard`; and the suite's verdicts can fail: on the wrong numbers, on the other branch, on NaN, and in the command's exit status."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from math import nan
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from flexfmu.benchmarks.hard_cases import repetition, singularity, suite
from flexfmu.benchmarks.hard_cases.case import (
    CLOSURE,
    NOT_FINITE,
    OFF_BRANCH,
    UNFINISHED,
    CaseReport,
    Criterion,
    HardCase,
    error_against,
    paper_robot,
    run_case,
    soundness,
)
from flexfmu.benchmarks.hard_cases.extremes import STIFF
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.model.scene.assembly import motor_angles

ROOT = Path(__file__).parents[2]
PASSED = CaseReport("all is well", (Criterion("error", 1e-6, 1e-5), Criterion(NOT_FINITE, 0.0, 0.0)))
FAILED = CaseReport("it blew | up", (Criterion("error", nan, 1e-5, "m"),))


@pytest.fixture(scope="module")
def run() -> Run:
    """The paper's robot, shortly."""
    return run_case(paper_robot(), {"trajectory.dwell": 0.0})


def changed(run: Run, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Run:
    """The run with other values of a signal."""
    column = run.recording[name]
    columns = {**run.recording.columns, name: Column(column.unit, change(column.values), column.first, column.second)}
    return replace(run, recording=Recording(run.recording.time, columns))


def shorter(run: Run) -> Run:
    """The first half of the run."""
    half = run.recording.time.size // 2
    columns = {name: Column(each.unit, each.values[:half]) for name, each in run.recording.columns.items()}
    return replace(run, recording=Recording(run.recording.time[:half], columns))


def test_a_number_that_is_none_never_passes() -> None:
    """NaN compares false with everything, which must not count as within the limit; nothing measured is no success."""
    assert not Criterion("error", nan, 1.0).passed
    assert [each.passed for each in (CaseReport("nothing was looked at", ()), FAILED, PASSED)] == [False, False, True]


Y = "end_effector.position.y"


@pytest.mark.parametrize(
    ("unsound", "complaint"),
    [
        (lambda run: changed(run, "joint1.torque", lambda x: np.where(np.arange(x.size) == 7, nan, x)), NOT_FINITE),
        (lambda run: changed(run, Y, lambda y: y + 1e-9), CLOSURE),
        (lambda run: changed(run, Y, lambda y: y - 0.6), OFF_BRANCH),
        (shorter, UNFINISHED),
    ],
    ids=["one NaN among thousands", "open by 1 nm", "other side of the elbows", "stopped early"],
)
def test_unsound_runs_are_seen(run: Run, unsound: Callable[[Run], Run], complaint: str) -> None:
    """The checks accept what is right, and name what isn't."""
    assert all(each.passed for each in soundness(run))
    assert not next(each.passed for each in soundness(unsound(run)) if each.name == complaint)


@pytest.mark.slow
def test_errors_are_counted_against_the_robot_that_was_meant(run: Run) -> None:
    """A robot whose payload is a thousandth heavier is off by about as much, and found out."""
    assert error_against(run, paper_robot(), STIFF, 1e-5).passed
    heavier = run_case(paper_robot(), {"trajectory.dwell": 0.0, "payload.mass": 6.006})
    wrong = error_against(replace(heavier, plan=run.plan), paper_robot(), STIFF, 1e-5)
    assert 3e-4 < wrong.value < 3e-3


def test_pose_of_the_singular_approach() -> None:
    """The elbows are as far from the middle as the case says, with the end effector between and below them."""
    mechanism = paper_robot().mechanism
    for half in singularity.HALF_DISTANCES:
        x, y = singularity.pose(mechanism, 1e-3 * half)
        q1, q2 = motor_angles(singularity.hanging_robot().mechanism, (x, y))
        elbows = [
            (base + mechanism.proximal.length * np.cos(q), mechanism.proximal.length * np.sin(q))
            for base, q in ((-mechanism.base_half_distance, q1), (mechanism.base_half_distance, q2))
        ]
        assert [elbows[0][0], elbows[1][0]] == pytest.approx([-1e-3 * half, 1e-3 * half], abs=1e-9)
        assert all(y < elbow[1] for elbow in elbows)


def test_command_tells_what_happened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A failed case, and one that can't even be run, are shown beside the others, with status 1; wrong options have 2."""

    def broken() -> CaseReport:
        raise SlaveError("plant", "it refuses")

    suspects = [("good", lambda: PASSED), ("bad", lambda: FAILED), ("broken", broken)]
    cases = tuple(HardCase(name, "a reason", run) for name, run in suspects)
    monkeypatch.setattr(suite, "FAMILIES", (lambda: cases,))
    everything = CliRunner().invoke(app, ["workprec", "--hard", "--json", "--out", str(tmp_path)])
    assert everything.exit_code == 1
    found = json.loads(everything.stdout)
    assert [case["passed"] for case in found["cases"]] == [True, False, False]
    assert found["cases"][1]["checks"][0]["value"] is None
    assert "it refuses" in found["cases"][2]["happened"]
    table = (tmp_path / "hard-cases.md").read_text(encoding="utf-8")
    assert "it blew \\| up. error nan m (NOT <= 1e-05) | FAILED |" in table
    page = (tmp_path / "hard-cases.html").read_text(encoding="utf-8")
    assert len(re.findall('<td class="value failed"[^>]*>FAILED</td>', page)) == 2
    assert all("2 of 3 hard cases failed: bad, broken." in text for text in (table, page))
    good = CliRunner().invoke(app, ["workprec", "--hard", "--only", "GOOD", "--out", str(tmp_path)])
    assert good.exit_code == 0
    assert "The hard case passed." in good.stdout
    for options, complaint in (
        ([], "needs a SCENE, or --hard"),
        (["barnard2012-6kg", "--hard"], "leave out barnard2012-6kg"),
        (["--hard", "--only", "easy"], "no hard case has 'easy' in its name"),
    ):
        wrong = CliRunner().invoke(app, ["workprec", *options])
        assert wrong.exit_code == 2
        assert complaint in wrong.stderr


def test_documentation_has_every_case() -> None:
    """The page shows the suite as it is."""
    if not (page := ROOT / "docs" / "speed.md").is_file():
        pytest.skip("tests run away from the source tree")
    text = page.read_text(encoding="utf-8").partition("\n## Hard cases\n")[2]
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    shown = [(row[0].removeprefix("| "), row[1]) for row in rows[2:]]
    assert shown == [(case.name, case.hard) for case in chain.from_iterable(each() for each in suite.FAMILIES)]
    assert all(row[-1] == "passed |" for row in rows[2:])


FULL = [each.name for each in repetition.cases()]
CASES = [*(each for each in suite.hard_cases() if each.name not in FULL), *repetition.cases(200)]
"""All families, the repetition shortened."""


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_case_goes_well(case: HardCase) -> None:
    """No hard case blows up, lies, or leaves its branch: each is held against solvers of other people or exact invariants."""
    finding = case.run()
    assert finding.passed, f"{finding.happened}; {suite.figures(finding)}"
