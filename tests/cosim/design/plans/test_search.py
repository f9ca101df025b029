"""The search finds fast motions within all limits, the same for any number of processes, and no grid finds better ones."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from itertools import islice
from subprocess import PIPE, Popen
from time import process_time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.design.plans import search as module
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals, goals_of
from flexfmu.cosim.design.plans.optimal import limited, robots_of
from flexfmu.cosim.design.plans.search import USUAL_SHAPE, FamilyMotion, families, improved, polynomial, search
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.timing import processor_time
from flexfmu.cosim.many.executor import mapping
from flexfmu.model.reference_design.optimal_control import GROUPS, MotionProblem, Stage
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.trajectories.profiles import PROFILES, evaluate_profile
from flexfmu.trajectories.shapers.sequence import Oscillator

SCENE = load_scene("barnard2012-0.1kg").replace({f"plan.limits.{name}": "free" for name in ("power", "rms_torque")})


@pytest.fixture(scope="module")
def goals() -> Goals:
    return goals_of(SCENE)


@pytest.fixture(scope="module")
def given(goals: Goals) -> Assessment:
    return Judge(goals, 3).given


@pytest.fixture(scope="module")
def first(goals: Goals) -> list[FamilyMotion]:
    return families(goals)


def limits_of(goals: Goals, given: Assessment) -> MotionProblem:
    """The limits for three payloads."""
    return limited(goals, given, [robots_of(goals.scene, goals.variations(3))])


@pytest.fixture(scope="module")
def problem(goals: Goals, given: Assessment) -> MotionProblem:
    return limits_of(goals, given)


def silent(text: str, fraction: float | None) -> None:
    """Shows nothing."""


SHAPED = {
    "two": (("zvd", Oscillator(70.0, 0.02)), ("zv", Oscillator(90.0, 0.02))),
    "one": (("ei", Oscillator(70.0, 0.02)),),
    "none": (),
}


@pytest.mark.parametrize("number", SHAPED)
def test_references_are_those_of_the_scene_that_is_written(number: str) -> None:
    section, shapers = SCENE.trajectory, SHAPED[number]
    assert isinstance(section, TrajectorySection)
    numbers = np.array([0.03, 0.8, 0.4, *USUAL_SHAPE, *[1.05] * len(shapers)])
    chosen = FamilyMotion(SCENE.mechanism, section, (0.025, 0.035), "polar", shapers, numbers, 0.2)
    planned = loop_of(SCENE.replace(chosen.changes)).motion.joints
    assert planned.duration == pytest.approx(0.2, rel=1e-12)
    fractions = np.linspace(0.0, 1.0, 301)
    expected = planned.evaluate(0.2 * fractions, 2, "left")
    for values, wanted in zip(chosen.evaluate(fractions), expected, strict=True):
        assert np.abs(values - wanted).max() < 1e-4 * np.abs(wanted).max()


def test_time_laws_move_forward_and_are_at_rest_at_both_ends() -> None:
    law = PROFILES["polynomial"].make(coefficients=polynomial((0.3, 0.5, -0.2, 0.4, 0.1, 0.0, 0.0, 0.2)))
    values = evaluate_profile(law, np.linspace(0.0, 1.0, 101), 2).derivatives()
    assert (values[1, 1:-1] > 0.0).all()
    assert values[:, 0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-8)
    assert values[:, -1] == pytest.approx([1.0, 0.0, 0.0], abs=1e-8)


def test_a_motion_moves_forward_where_its_conditions_hold(first: list[FamilyMotion]) -> None:
    random, seen = np.random.default_rng(1), set[bool]()
    for _ in range(40):
        shape = random.uniform(-0.75, 0.75, 8)
        motion = replace(first[0], numbers=np.array([*first[0].numbers[:3], *shape]))
        holds = bool((motion.conditions()[0] < 0.0).all())
        seen.add(holds)
        if holds:
            motion.evaluate([0.0, 0.5, 1.0])
    assert seen == {True, False}


@pytest.mark.parametrize("number", [0, 2, 7])
def test_derivatives_of_limits_are_those_of_longer_differences(
    problem: MotionProblem, first: list[FamilyMotion], number: int
) -> None:
    """By numbers and by the duration: references, torques, clearance, and what vibrates at the end."""
    motion = first[number].with_duration(0.25)
    stage = Stage(problem, (motion,), 2)
    linear = stage.linear(stage.state((motion,)))
    direction = 1e-3 * np.random.default_rng(0).standard_normal(len(motion.numbers) + 1) * motion.measures(0.3)[0]

    def moved(sign: int) -> list[Any]:
        found = stage.state((motion.moved(sign * direction),), derivatives=False)
        return [found.values[linear.deciding], found.amplitudes]

    differences = [0.5 * (ahead - behind) for ahead, behind in zip(moved(1), moved(-1), strict=True)]
    # jerks jump where corners begin
    near = linear.groups != GROUPS.index("jerk")
    pairs = [(linear.jacobian @ direction)[near], linear.amplitudes_by @ direction]
    for difference, by, rounding in zip([differences[0][near], differences[1]], pairs, (0.0, 2e-8), strict=True):
        assert np.abs(difference - by).max() < 0.08 * np.abs(by).max() + rounding


@pytest.mark.slow
def test_no_grid_finds_a_better_motion(problem: MotionProblem, first: list[FamilyMotion]) -> None:
    found = improved(problem, "time", (first[2], np.arange(3), 2, 20))
    assert found is not None
    motion = first[2].moved(np.array(found[0]) - first[2].variables)
    stage = Stage(problem, (motion,), 2)
    assert max(stage.state((motion,), derivatives=False).violations.values()) < 2e-3
    # width and height of the corners and the duration, with all other numbers those of the motion found
    for time in np.linspace(0.8, 0.99, 6):
        for width in np.linspace(0.05, 0.95, 5):
            for tall in np.linspace(0.65, 1.0, 3):
                numbers = np.array([motion.numbers[0], tall, width, *motion.numbers[3:]])
                other = replace(motion, numbers=numbers, duration=time * motion.duration)
                assert max(stage.state((other,), derivatives=False).violations.values()) > 2e-3


def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search of few families and programmes."""
    monkeypatch.setattr(module, "SINGLE", ("zvd", "ei"))
    monkeypatch.setattr(module, "PAIRS", ())
    monkeypatch.setattr(module, "KEPT", 1)
    monkeypatch.setattr(module, "LAST", 1)
    monkeypatch.setattr(module, "ROUNDS", ((2, 1, 3), (3, 1, 4)))
    monkeypatch.setattr(module, "PAYLOADS", (3,))


@pytest.mark.slow
def test_motions_are_within_limits_for_any_number_of_processes(
    goals: Goals, given: Assessment, monkeypatch: pytest.MonkeyPatch
) -> None:
    small(monkeypatch)
    motions = list(search(Judge(goals, 3), [given], 1, silent))
    # all that follows the first motion is made of it in this process
    (other,) = islice(search(Judge(goals, 3), [given], 2, silent), 1)
    assert (other.label, other.scene) == (motions[0].label, motions[0].scene)
    judged = [Judge(goals, 3).assess(each) for each in motions]
    assert any(each.feasible and each.time < 0.8 * SCENE.trajectory.duration for each in judged)


def test_a_search_that_is_left_ends(goals: Goals, given: Assessment, monkeypatch: pytest.MonkeyPatch) -> None:
    small(monkeypatch)
    motions = search(Judge(goals, 3), [given], 2, silent)
    assert next(motions).method == "search"
    motions.close()  # type: ignore[attr-defined]
    assert list(motions) == []


@pytest.mark.slow
def test_least_residual_at_a_given_time() -> None:
    wishes = {"plan.minimise": "residual", "plan.duration": 0.25, "plan.payload_band": 0.1}
    goals = goals_of(SCENE.replace(wishes))
    judge, first, residuals = Judge(goals, 3), families(goals)[2], list[float]()
    problem = limits_of(goals, judge.given)
    for programmes in (0, 8):
        found = improved(problem, "residual", (first, np.arange(3), 2, programmes))
        assert found is not None
        motion = first.moved(np.array(found[0]) - first.variables)
        assert motion.duration == pytest.approx(0.25)
        residuals.append(judge.assess(Candidate("", "search", goals.scene.replace(motion.changes))).residual)
    assert residuals[1] < 0.5 * residuals[0]


def test_paths_go_around_walls(goals: Goals, given: Assessment) -> None:
    """The first one that doesn't pass through one, however thin; what passes through counts by the way around."""
    x, y = SCENE.start
    wall = {"kind": "box", "corners": [[x + 0.1, y - 0.045], [x + 0.1005, y + 0.01]]}
    walled = goals_of(SCENE.replace({"plan.keep_out": [wall]}))
    first = families(walled)[0]
    assert walled.clearance.passage(first.points) == 0.0
    low = replace(first, numbers=np.array([first.heights[0], *first.numbers[1:]]))
    distance = limits_of(walled, given).ways[0].distances(low.points[np.newaxis])[0]
    assert distance.min() < -5e-3


def test_a_search_needs_a_path() -> None:
    tabulated = SimpleNamespace(scene=SimpleNamespace(name="log", trajectory=None), wishes=None)
    judge: Any = SimpleNamespace(goals=tabulated, journal=None)
    with pytest.raises(InputError, match="scene log has a motion from a table, and no path whose corners could change"):
        next(search(judge, (given,), 1, silent))


def _busy(seconds: float) -> float:
    """Work for some seconds of processor time."""
    end = process_time() + seconds
    while process_time() < end:
        pass
    return seconds


def test_the_processor_time_of_all_processes_counts() -> None:
    """What the processes of a search worked is there when it is left, by its end or before."""
    for count in (4, 1):
        before = processor_time()
        with mapping(_busy, 2) as mapped:
            assert [*islice(mapped([0.2] * max(count, 2)), count)] == [0.2] * count
        assert processor_time() - before > 0.2 * max(count, 2)


def test_a_process_that_is_killed_is_an_error_in_one_sentence() -> None:
    """As when memory runs out: the plan goes on with what else it has."""
    with mapping(_killed, 2) as mapped, pytest.raises(ResultsError, match="a process ended"):
        list(mapped([None] * 2))


def _killed(task: None) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


STOPPED = """
import time
from contextlib import suppress
from typer import Exit
from flexfmu.cosim.many.executor import mapping
from flexfmu.cosim.cli.console import one_line_errors, orderly_termination
with suppress(Exit), orderly_termination(), one_line_errors(), mapping(abs, 2) as mapped:
    list(mapped([1.0] * 4))
    print("started", flush=True)
    time.sleep(600.0)
"""


@pytest.mark.skipif(os.name != "posix", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_processes_that_are_stopped_are_silent(number: signal.Signals) -> None:
    """Ctrl-C and the end of a session reach all processes of a group: one line, and no traceback of a worker."""
    process = Popen([sys.executable, "-c", STOPPED], stdout=PIPE, stderr=PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    os.killpg(process.pid, number)
    _, errors = process.communicate(timeout=600)
    assert errors == "flexfmu: interrupted\n"
