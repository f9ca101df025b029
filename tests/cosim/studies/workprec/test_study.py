"""Studies of work and precision: references agree, errors fall as they should, failures are kept and told; polynomials stand for motions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import casadi
import numpy as np
import pytest
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.effects.runs import is_smooth
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.timing import MOST, fastest, fastest_in_turns
from flexfmu.cosim.many.journal import WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.studies.workprec import solver_trials
from flexfmu.cosim.studies.workprec import study as studys
from flexfmu.cosim.studies.workprec.figures import html, lines_of, picture, save_figures
from flexfmu.cosim.studies.workprec.solver_trials import BoundFunction, formulation_trials
from flexfmu.cosim.studies.workprec.trial import RunError, SceneUnderTest, fmu_trials, subject_of, sweep
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

SCENE: Scene = load_scene("barnard2012-6kg").replace(
    {
        "name": "short",
        "effects.basis": "craig-bampton",
        "effects.proximal_bending": 1,
        "effects.distal_axial": 1,
        "trajectory.duration": 0.25,
        "trajectory.dwell": 0.02,
    }
)


@pytest.fixture(scope="module")
def subject() -> SceneUnderTest:
    """A short motion of a robot with few modes."""
    return subject_of(SCENE)


@pytest.mark.slow
def test_independent_references_agree(subject: SceneUnderTest) -> None:
    """Gauss collocation in our FMU and DOP853 on the compiled equations share neither integrator nor master."""
    assert subject.error(solver_trials.independent_reference(subject)) < 1e-10
    assert 1e-4 < subject.scale < 1e-2


@pytest.mark.slow
def test_other_solvers_get_the_exact_jacobian(subject: SceneUnderTest) -> None:
    """What SciPy's methods and CasADi's solvers are given is compiled, and the derivative of the rate to the accuracy of
    central differences."""
    system, (_, part, *_) = solver_trials.system_of(subject)
    assert {system.rate.class_name(), system.jacobian.class_name()} == {"External"}
    rate, jacobian = BoundFunction(system.rate, part.numbers), system.bound_jacobian(part.numbers)
    time = 0.6 * part.begin + 0.4 * part.end
    z = system.start + 1e-5 * np.random.default_rng(5).normal(size=2 * system.n)
    columns = [(rate(time, z + step) - rate(time, z - step)) / 2e-7 for step in 1e-7 * np.eye(2 * system.n)]
    exact = jacobian(time, z)
    np.testing.assert_allclose(exact, np.transpose(columns), rtol=0.0, atol=1e-9 * np.abs(exact).max())


@pytest.mark.slow
def test_other_tools_reach_our_errors(subject: SceneUnderTest) -> None:
    """Each solver gets there with its own tolerance."""
    ours = WorkCurve((WorkPrecisionTrial("tools", "flexfmu", "", 1e-5, 1e9),))
    trials = [*solver_trials.scipy_trials(subject, ours), *solver_trials.sundials_trials(subject, ours)]
    for line in ("SciPy Radau", "SciPy BDF", "SciPy LSODA", "SciPy DOP853", "CasADi cvodes"):
        assert WorkCurve.of(each for each in trials if each.line == line).least <= 1e-5, line


def test_shaped_scenes_are_compared_with_themselves() -> None:
    """Shapers belong to the motion that other tools get; a sampled one makes steps of it, which no equation here has."""
    mode = {"kind": "zv", "modes": [{"frequency": 58.0, "ratio": 0.1}]}
    shaped = SCENE.replace({"shaper": [mode | {"apply": "path"}]})
    assert subject_of(shaped).stop > subject_of(SCENE).stop + 5e-3
    assert is_smooth(shaped)
    assert not is_smooth(SCENE.replace({"cosimulation.drive": "torque"}))
    assert not is_smooth(SCENE.replace({"shaper": [mode | {"apply": "sampled", "sample_time": 1e-3}]}))


@pytest.mark.slow
def test_errors_fall_with_tolerance_and_order(subject: SceneUnderTest) -> None:
    """A tighter tolerance and a higher degree of the inputs are worth their time: each lowers the error."""
    changes, options = {"cosimulation.integrator": "radau3"}, {"communication_step": 1e-3}
    errors = []
    for tolerance in (1e-3, 1e-6, 1e-9):
        (trial,) = fmu_trials(subject, "", [("radau3", "", changes, {**options, "tolerance": tolerance})])
        assert trial.error is not None
        assert trial.time is not None
        errors.append(trial.error)
    assert errors[0] > 10.0 * errors[1] > 100.0 * errors[2]
    options = {"communication_step": 2e-3, "tolerance": 1e-10}
    orders = [("", "", {}, {**options, "input_order": order}) for order in (0, 2, 9)]
    by_order = [trial.error for trial in fmu_trials(subject, "", orders)]
    assert by_order[0] > 10.0 * by_order[1] > 1e4 * by_order[2]  # type: ignore[operator]


@pytest.mark.slow
def test_formulations(subject: SceneUnderTest) -> None:
    """All formulations move alike; without stabilisation the constraints drift more."""
    trials = list(formulation_trials(subject))
    best = {
        line: min(t.error for t in trials if t.line == line and t.error is not None)
        for line in {t.line for t in trials}
    }
    assert len(best) == 3
    assert max(best.values()) < 1e-4
    drift = {t.line: float(t.note.split()[-2]) for t in trials if t.label == "1e-03" and "violated" in t.note}
    assert drift["index 1, Baumgarte 100/s"] < 0.2 * drift["index 1"]


@pytest.mark.slow
def test_the_ladder_climbs() -> None:
    """Rigid links are wrong by all that elasticity does, and richer sets are nearer to the one with all effects. A run of all takes
    longer than one of rigid links. What a loop has no answer for is named."""
    study = studys.run_study(SCENE, ["algorithms", "effects"], lambda text: None)
    assert study.families == ("effects",)
    assert "algorithms: left out" in " ".join(studys.notes(study))
    names = ("rigid", "4 coordinates", "12 coordinates")
    errors = [study.floors["effects", name] for name in names]
    assert errors[0] == pytest.approx(1.0, rel=1e-2)
    assert errors == sorted(errors, reverse=True)
    lines = lines_of(study, "effects")
    (most,) = (line for line in lines if line.startswith("richest ("))
    least, longest = (min(each.time or 0.0 for each in lines[name]) for name in ("rigid", most))
    assert longest > 1.2 * least > 0.0


TRIALS = (
    WorkPrecisionTrial("integrators", "gauss4", "1e-5", 1e-6, 4e-3),
    WorkPrecisionTrial("integrators", "gauss2", "1e-3", 5e-4, 2e-3),
    WorkPrecisionTrial("integrators", "rk4", "0.1 ms", None, None, "blew up"),
    WorkPrecisionTrial("communication", "inputs of degree 9", "5 ms", 2e-5, 1e-3),
    WorkPrecisionTrial("tools", "flexfmu", "gauss4 1e-5", 1e-6, 4e-3),
    WorkPrecisionTrial("tools", "flexfmu", "gauss2 1e-3", 1e-4, 2e-3),
    WorkPrecisionTrial("tools", "SciPy Radau", "1e-3", 1e-4, 0.2),
    WorkPrecisionTrial("tools", "SciPy Radau", "1e-5", 1e-6, 0.8),
    WorkPrecisionTrial("tools", "Exudyn", "1 ms", 5e-3, 0.5),
    WorkPrecisionTrial("tools", "fixed step of 10 MHz", "", 1e-6, 40.0),
)
"""Made-up figures."""


@pytest.fixture
def study() -> studys.WorkPrecisionStudy:
    """A study of made-up figures."""
    return studys.WorkPrecisionStudy(SCENE, 0.27, 2e-4, 1e-10, "two", TRIALS)


def test_sentence_and_advantages(study: studys.WorkPrecisionStudy) -> None:
    """The cheapest settings that are accurate enough, failures left out; others compared at an error that both have, by
    interpolation on both curves, and nearest to it where they have not reached it."""
    assert studys.sentence(study) == (
        "An error of 1e-05 costs 4.0 ms with gauss4 at a tolerance of 1e-5, 68 times faster than real time; one of 1e-03 costs 1.0 ms with "
        "inputs of degree 9 at steps of 5 ms."
    )
    assert studys.cheapest(TRIALS, 1e-9) is None
    assert studys.sentence(replace(study, trials=TRIALS[1:3])) == "No setting reached 1e-05."
    assert studys.advantages(study).keys() == {"SciPy Radau", "Exudyn"}
    radau, exudyn = studys.advantages(study).values()
    assert radau == (1e-5, pytest.approx(0.4 / 8e-6**0.5))
    assert exudyn == (5e-3, pytest.approx(250.0))
    text = " ".join(studys.notes(study))
    assert "For an error of 1.0e-05 other tools take longer than flexfmu: SciPy Radau 141 times." in text
    assert "For an error of 5.0e-03 other tools take longer than flexfmu: Exudyn 250 times." in text


def test_curves_and_sweeps() -> None:
    """A curve has the settings that none beats, its time between them goes with a power of the error, and beyond its ends it
    is that of the loosest, or unknown. Another tool is tried until it is as accurate, or a hundred times as slow."""
    settings = [(1e-2, 1.0), (1e-3, 3.0), (1e-4, 2.0), (1e-6, 8.0), (None, None)]
    trials = [WorkPrecisionTrial("tools", "any", str(error), error, time) for error, time in settings]
    ours = WorkCurve.of(trials)
    assert [each.error for each in ours.trials] == [1e-6, 1e-4, 1e-2]
    assert ours.time(1e-5) == pytest.approx(4.0)
    assert (ours.time(1.0), ours.time(1e-7)) == (pytest.approx(1.0), None)
    accurate = [WorkPrecisionTrial("tools", "accurate", "", error, 9.0) for error in (1e-3, 1e-6, 1e-9)]
    slow = [
        WorkPrecisionTrial("tools", "slow", "", *each)
        for each in ((None, None), (1e-2, 10.0), (1e-4, 200.0), (1e-5, 500.0))
    ]
    assert list(sweep(accurate, lambda trial: trial, ours)) == accurate[:2]
    assert list(sweep(slow, lambda trial: trial, ours)) == slow[:3]
    assert list(sweep(slow, lambda trial: trial, WorkCurve(()))) == slow


@pytest.mark.slow
def test_results_hold_everything(study: studys.WorkPrecisionStudy, tmp_path: Path) -> None:
    """Table, data, pictures and page name every line, failures included; the page fetches nothing."""
    names = save_figures(study, tmp_path)
    assert names == ["integrators", "communication", "tools"]
    assert all((tmp_path / f"workprec-{name}.png").stat().st_size > 10_000 for name in names)
    page, text = html(study), studys.markdown(study)
    assert all(trial.line in text and trial.line in page for trial in TRIALS)
    assert "blew up" in text
    assert "rk4, failed" in page
    assert 'src="http' not in page
    assert [each.label for each in lines_of(study, "tools")["flexfmu"]] == ["gauss4 1e-5", "gauss2 1e-3"]
    assert json.loads(json.dumps(studys.data(study)))["trials"][2]["error"] is None


def test_axes_have_plain_numbers(study: studys.WorkPrecisionStudy) -> None:
    """Times and real-time factors below one are written like those above; ticks beyond the axis aren't drawn."""
    trials = (WorkPrecisionTrial("tools", "slow", *each) for each in (("a", 1e-3, 9.0), ("b", 1e-5, 0.009)))
    figure = picture(replace(study, trials=tuple(trials)), ["tools"])
    figure.draw_without_rendering()
    (axes,) = figure.axes
    (factor,) = axes.child_axes
    for side, numbers in ((axes, {"10", "100", "1000"}), (factor, {"0.1", "1", "10"})):
        low, high = side.get_ylim()
        labels = side.yaxis.get_ticklabels(which="both")
        texts = {label.get_text() for label in labels if low <= label.get_position()[1] <= high}
        assert numbers <= texts
        assert not any("e" in text for text in texts)


def test_timing_takes_the_fastest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs are repeated until they have taken a tenth of a second in all, or often enough; a long one is not repeated. Those that
    are compared take turns, as many each, on a machine that gets faster."""
    passed = [0.0]
    monkeypatch.setattr("flexfmu.cosim.experiment.timing.process_time", lambda: sum(passed))

    def taking(times: Iterator[float]) -> Callable[[], None]:
        return lambda: passed.append(next(times))

    for times, expected in (([0.04, 0.02, 0.03, 0.02, 0.01], 0.02), ([1e-3] * (MOST + 2), 1e-3), ([0.2, 0.5], 0.2)):
        coming = iter(times)
        assert fastest(taking(coming)) == pytest.approx(expected)
        assert len([*coming]) == 1
    for slow, expected_both in (([0.2, 0.1, 0.1], (0.02, 0.2)), ([0.08, 0.04, 0.07], (0.01, 0.04))):
        both = [taking(iter(each)) for each in ([0.02, 0.01, 0.01], slow)]
        assert fastest_in_turns(both) == pytest.approx(expected_both)


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    """One family of a changed scene from the command line, as JSON, with all files."""
    out, changes = (
        tmp_path / "out",
        ("trajectory.duration=0.25", "effects.proximal_bending=1", "effects.distal_axial=1"),
    )
    settings = [word for change in changes for word in ("--set", change)]
    arguments = ["workprec", "barnard2012-6kg", *settings, "--out", str(out), "--only", "communication", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["agreement"] < 1e-9
    assert {trial["family"] for trial in found["trials"]} == {"communication"}
    assert np.isfinite([trial["error"] for trial in found["trials"]]).all()
    assert {path.name for path in out.iterdir()} >= {"workprec.json", "workprec.md", "workprec.html", "workprec.png"}


def test_measured_trials_are_kept_and_failed_ones_tried_again(tmp_path: Path) -> None:
    """The next study of the scene has the figures of the first one bit for bit; what has failed is measured anew."""
    asked = list[str]()

    def measured(value: float) -> tuple[float, float, str]:
        asked.append("measured")
        return value, 0.1, "3 steps"

    def failing() -> tuple[float, float, str]:
        asked.append("failing")
        raise RunError("no")

    def trials() -> list[WorkPrecisionTrial]:
        found = replace(subject_of(SCENE), journal=WorkJournal(tmp_path, "study", about_scene(SCENE)))
        return [found.trial("tools", "a", "1", lambda: measured(0.1 + 0.2)), found.trial("tools", "a", "2", failing)]

    assert trials() == trials()
    assert asked == ["measured", "failing", "failing"]


def test_an_interruption_is_no_failed_trial(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A run that Ctrl-C ends ends the study, which keeps none of it and says what it has."""

    def interrupted(prepared: PreparedScene, *_: object) -> object:
        return SimpleNamespace(outcome=Outcome.INTERRUPTED)

    monkeypatch.setattr(PreparedScene, "run", interrupted)
    for options in (["--of", "peak_torque_1"], ["--only", "integrators"]):
        result = CliRunner().invoke(app, ["workprec", "barnard2012-6kg", "--out", str(tmp_path), "--restart", *options])
        assert result.exit_code == 1
        assert f"interrupted: 0 runs are kept in {tmp_path}; the same command continues" in result.stderr


@pytest.mark.parametrize("profile", [{"kind": "poly7"}, {"kind": "bang-bang"}, {"kind": "trapezoidal", "ramp": 0.125}])
@pytest.mark.parametrize("blend", ["lame", "clothoid", "polar"])
def test_angles_rates_and_accelerations(profile: dict[str, object], blend: str) -> None:
    """Between breakpoints and up to both of their sides, for every kind of motion, dwell included."""
    scene = load_scene("barnard2012-6kg").replace({"trajectory.profile": profile, "trajectory.blend.kind": blend})
    motion = plan(scene)
    parts = solver_trials.motion_polynomials(motion.joints, motion.stop_time)
    assert parts[0].begin == 0.0
    assert parts[-1].end == motion.stop_time
    assert all(a.end == b.begin for a, b in pairwise(parts))
    for part in parts:
        time = np.linspace(part.begin, part.end, 23)[1:-1]
        exact = motion.joints.evaluate(time, 2)
        x = (2.0 * time - part.begin - part.end) / (part.end - part.begin)
        for derivative, tolerance in enumerate((1e-12, 1e-9, 1e-6)):
            found = np.polynomial.chebyshev.chebval(x, part.coefficients[derivative]).T
            scale = max(1.0, np.abs(exact[derivative]).max())
            np.testing.assert_allclose(found, exact[derivative], rtol=0.0, atol=tolerance * scale)


def test_the_solvers_read_the_same_numbers() -> None:
    """The order of the coefficients in the vector that solvers get is the one in which they read it."""
    motion = plan(load_scene("barnard2012-6kg"))
    part = solver_trials.motion_polynomials(motion.joints, motion.stop_time)[3]
    t, numbers = casadi.SX.sym("t"), casadi.SX.sym("piece", part.numbers.size)
    function = casadi.Function("u", [t, numbers], [solver_trials.joint_motion(t, numbers)])
    time = 0.3 * part.begin + 0.7 * part.end
    exact = motion.joints.evaluate(time, 2)[:, 0].ravel()
    np.testing.assert_allclose(function(time, part.numbers).full().ravel(), exact, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_a_study_of_metrics_has_floors_and_a_front() -> None:
    """No setting beats its own set of effects, richer sets reach further, and the cheapest of all gets dearer with the accuracy."""
    study = studys.run_metric_study(SCENE, ["peak_torque_1"])
    trials = study.family("peak_torque_1")
    for (_, line), floor in study.floors.items():
        assert all(each.error >= floor for each in trials if each.line == line and each.error is not None)
    rigid, four = (study.floors["peak_torque_1", line] for line in ("rigid", "4 coordinates"))
    assert rigid > 10.0 * four > 0.0
    rows = [row for row in studys.accuracy_rows(study) if row[2] != "–"]
    assert [row[-1].endswith("numerics alone") for row in rows] == [float(row[1]) < study.known[row[0]] for row in rows]
    assert 1e-10 < study.known["peak_torque_1"] < 1e-2
    times = [float(row[2]) for row in rows]
    assert len(times) >= 6
    assert times == sorted(times)
    # a picture and a page of it
    (axes,) = picture(study, ["peak_torque_1"]).axes
    assert "cheapest of all" in axes.get_legend_handles_labels()[1]
    assert "cheapest of all" in html(study)
    assert "peak_torque_1" in studys.sentence(study)


@pytest.mark.parametrize(
    ("options", "message"),
    [(["--of", "torque"], "did you mean"), (["--of", "peak_torque_1", "--hard"], "--of goes without")],
)
def test_wrong_metrics_of_a_study_are_one_line(tmp_path: Path, options: list[str], message: str) -> None:
    """Unknown metrics, and options that don't go together."""
    result = CliRunner().invoke(app, ["workprec", "barnard2012-6kg", "--out", str(tmp_path), *options])
    assert result.exit_code == 2
    assert message in result.stderr
