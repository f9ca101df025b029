"""The search finds fast motions within all limits, the same for any number of processes, and no grid finds better ones."""

from __future__ import annotations

import os
import signal
import sys
from itertools import islice
from subprocess import PIPE, Popen
from time import process_time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.design.plans import search as module
from flexfmu.cosim.design.plans.assessment import Candidate, Judge
from flexfmu.cosim.design.plans.designs import LAWS, Design, MotionFamily, ShaperChoice, polynomial, references
from flexfmu.cosim.design.plans.goals import goals_of
from flexfmu.cosim.design.plans.search import MotionSearch, search, study_of
from flexfmu.cosim.design.plans.sequential_programme import MotionStudy, best_change, first_iterate, improved
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.timing import processor_time
from flexfmu.cosim.many.executor import mapping
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.profiles import PROFILES, evaluate_profile

SCENE = load_scene("barnard2012-0.1kg").replace({f"plan.limits.{name}": "free" for name in ("power", "rms_torque")})

TIGHT = {"torque": 1.0, "speed": 1.0}

FAMILY = MotionFamily("lame", "modified-trapezoid", (("zvd", 0, "joints"),))


@pytest.fixture(scope="module")
def study() -> MotionStudy:
    return study_of(goals_of(SCENE), 3, 1e-3)


def design(*shapers: ShaperChoice) -> Design:
    law = polynomial((0.1, 0.2, -0.1, 0.1))
    return Design("polar", (0.024, 0.05), 0.03, "polynomial", law, shapers, 0.2)


SHAPED = {
    "joints": (ShaperChoice("zvd", (70.0,), 0.02, "joints"), ShaperChoice("zv", (90.0,), 0.02, "joints")),
    "path": (ShaperChoice("ei", (70.0,), 0.02, "path"),),
    "both": (ShaperChoice("zvd", (70.0,), 0.02, "path"), ShaperChoice("si", (60.0, 80.0), 0.02, "joints")),
    "none": (),
}


@pytest.mark.parametrize("place", SHAPED)
def test_references_are_those_of_the_scene_that_is_written(place: str) -> None:
    found = references(SCENE, design(*SHAPED[place]), 300)
    planned = loop_of(SCENE.replace(design(*SHAPED[place]).changes)).motion.joints
    assert found.duration == pytest.approx(planned.duration, rel=1e-12)
    exact = planned.evaluate(found.time, 2, "left")
    for values, expected in zip(found.values, exact, strict=True):
        assert np.abs(values - expected).max() < 1e-5 * np.abs(expected).max()
    # the quintic of each step ends where the next one begins
    taylor = found.time[1] ** np.arange(6) / np.cumprod([1, 1, 2, 3, 4, 5])
    ends = np.einsum("j,nji->ni", taylor, found.polynomials)
    assert ends == pytest.approx(found.values[0, 1:], abs=1e-12)


@pytest.mark.slow
def test_quick_runs_agree_with_the_scene(study: MotionStudy) -> None:
    chosen = design(*SHAPED["joints"])
    trial = study.tried(chosen)
    assert trial is not None
    scene = study.scene.replace(chosen.changes)
    masses = [each.payload for each in goals_of(SCENE).variations(3)]
    runs = [run_scene(scene, parameters={"payload.mass": mass}, tolerance=1e-7) for mass in masses]
    names = [f"{name}_{joint}" for name in ("peak_torque", "rms_torque", "positive_energy") for joint in (1, 2)]
    exact = [metrics_of(run, ["residual_vibration_amplitude", *names]) for run in runs]
    residual = max(each["residual_vibration_amplitude"] or 0.0 for each in exact)
    assert trial.score.values["residual"] == pytest.approx(residual, rel=2e-2)
    torques = [[each["peak_torque_1"], each["peak_torque_2"]] for each in exact]
    assert trial.score.run.peak_torques == pytest.approx(np.array(torques, dtype=float), rel=5e-3)
    means = [[each["rms_torque_1"], each["rms_torque_2"]] for each in exact]
    assert trial.score.loads["rms_torque"] == pytest.approx(np.array(means, dtype=float), rel=2e-2)
    energies = [float(each["positive_energy_1"] or 0.0) + float(each["positive_energy_2"] or 0.0) for each in exact]
    assert trial.score.loads["energy"] == pytest.approx(np.array(energies), rel=2e-2)


def test_time_laws_move_forward_and_are_at_rest_at_both_ends() -> None:
    law = PROFILES["polynomial"].make(**dict(polynomial((0.3, 0.5, -0.2, 0.4, 0.1, 0.0, 0.0, 0.2))))
    values = evaluate_profile(law, np.linspace(0.0, 1.0, 101), 2).derivatives()
    assert (values[1, 1:-1] > 0.0).all()
    assert values[:, 0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-8)
    assert values[:, -1] == pytest.approx([1.0, 0.0, 0.0], abs=1e-8)


def linear(x: float, y: float) -> Any:
    """A score whose figures are linear in two numbers: minimise 2 - x - y within x + 2y <= 1 and 3x + y <= 1."""
    rows = {"torque": np.array([x + 2.0 * y]), "speed": np.array([3.0 * x + y])}
    return SimpleNamespace(rows=rows, minimised=np.array([2.0 - x - y]))


@pytest.mark.parametrize(("highest", "vertex"), [(1.0, [0.2, 0.4]), (0.1, [0.1, 0.1])])
def test_linear_programmes_go_to_the_vertex(highest: float, vertex: list[float]) -> None:
    """Within the trust region."""
    near, free = [linear(0.01, 0.0), linear(0.0, 0.01)], (np.zeros(0), np.zeros((0, 2)))
    bounds = -np.ones(2), np.full(2, highest)
    change, predicted = best_change(linear(0.0, 0.0), near, np.full(2, 0.01), TIGHT, *bounds, free)
    assert change == pytest.approx(vertex)
    assert predicted == pytest.approx(0.5 * sum(vertex))


@pytest.mark.slow
def test_no_grid_finds_a_better_motion(study: MotionStudy) -> None:
    iterate = first_iterate(study, FAMILY, study.space.start(FAMILY), {})
    first = iterate.cost
    iterate = improved(study, iterate, 8)
    assert iterate.best is not None
    assert iterate.best.score.feasible
    assert iterate.cost < first - 0.1
    # time and width of the corners, with all other numbers those of the motion found
    costs = []
    for time in np.linspace(iterate.point[0] - 0.08, iterate.point[0] + 0.02, 6):
        for width in np.linspace(0.05, 0.95, 6):
            point = np.array([time, *iterate.point[1:3], width, *iterate.point[4:]])
            trial = study.at(FAMILY, point)
            costs.append(np.inf if trial is None or not trial.score.feasible else trial.score.objective)
    assert iterate.best.score.objective <= min(costs) + 5e-3


def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search of a few families and steps."""
    uses = [(("zvd", 0, "joints"),), (("ei", 0, "joints"),)]
    monkeypatch.setattr(module, "shaper_uses", lambda modes: uses)
    monkeypatch.setattr(module, "motion_families", lambda best, laws=LAWS: [FAMILY])
    monkeypatch.setattr(module, "KEPT", 1)
    monkeypatch.setattr(module, "ROUNDS", ((2, 2),))


@pytest.mark.slow
def test_motions_are_within_limits_for_any_number_of_processes(
    study: MotionStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    small(monkeypatch)
    motions, others = (list(MotionSearch(study, study, 3, processes).found()) for processes in (1, 2))
    assert len(motions) > 2
    assert [each.design for each in motions] == [each.design for each in others]
    assert all(each.score.feasible for each in motions)
    # and get better
    best = min(motions, key=lambda each: each.score.values["time"])
    goals = goals_of(SCENE)
    judged = Judge(goals, 3).assess(Candidate("best", "search", goals.scene.replace(best.design.changes)))
    assert judged.feasible
    assert judged.time < 0.8 * SCENE.trajectory.duration


def test_a_search_that_is_left_ends(study: MotionStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    small(monkeypatch)
    motions = MotionSearch(study, study, processes=2).found()
    assert next(motions).score.values["time"] > 0.0
    motions.close()  # type: ignore[attr-defined]
    assert list(motions) == []


@pytest.mark.slow
def test_least_residual_at_a_given_time() -> None:
    wishes = {"plan.minimise": "residual", "plan.duration": 0.25, "plan.payload_band": 0.1}
    study = study_of(goals_of(SCENE.replace(wishes)), 3, 1e-3)
    first = first_iterate(study, FAMILY, study.space.start(FAMILY), {})
    last = improved(study, first, 4)
    assert first.best is not None
    assert last.best is not None
    assert last.best.design.total == pytest.approx(0.25)
    assert last.best.score.values["residual"] < 0.7 * first.best.score.values["residual"]
    assert last.best.score.feasible


def test_a_search_needs_a_path() -> None:
    tabulated: Any = SimpleNamespace(scene=SimpleNamespace(name="log", trajectory=None), wishes=None)
    with pytest.raises(InputError, match="scene log has a motion from a table, and no path whose corners could change"):
        next(search(tabulated, (), 1, lambda text, fraction: None))


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
