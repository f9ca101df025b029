"""What was identified, as bands and robots for plans, margins, tunings and sweeps: they contain the intervals, and are worth their single runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.gains.goals import parse_goal
from flexfmu.cosim.design.gains.robustness import band_masses, parse_band
from flexfmu.cosim.design.gains.trial import Interval, Study, margin_figures
from flexfmu.cosim.design.identification.result import Estimated, Identification
from flexfmu.cosim.design.plans.goals import goals_of
from flexfmu.cosim.experiment.parameters import scene_with_parameters
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.cosim.studies.sweep.cases import as_cases
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.plan import PlanSection

SCENE = load_scene("barnard2012-6kg").replace({"effects.proximal_bending": 1, "effects.distal_axial": 0})
LOOP = SCENE.replace(
    {
        "cosimulation.drive": "torque",
        "cosimulation.step": 1e-3,
        "cosimulation.tolerance": 1e-4,
        "trajectory.duration": 0.2,
        "trajectory.dwell": 0.0,
        "effects.motor_inertia": 0.1,
        "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 60.0, "sample_time": 1e-3}],
    }
)
KEYS = {
    "payload.mass": ("payload.mass", 5.5),
    "material.youngs_modulus": ("mechanism.material.youngs_modulus", 66e9),
    "damping.ratio": ("effects.damping.ratio", 0.12),
}


def identification(rng: np.random.Generator, count: int = 3, skew: float = 0.4, name: str = "robot") -> Identification:
    """Drawn standard errors and correlations of payload, Young's modulus and damping; intervals are wider to one side by the skew."""
    estimates, factor = list[Estimated](), rng.normal(size=(count, count + 1))
    for parameter, (key, value) in [*KEYS.items()][:count]:
        error, sides = value * rng.uniform(0.005, 0.05), 1.96 * (1.0 + skew * rng.uniform(-1.0, 1.0, 2))
        interval = value - sides[0] * error, value + sides[1] * error
        estimates.append(Estimated(parameter, "1", value, value, error, interval, key=key))
    errors = np.array([each.standard_error for each in estimates])
    powers = factor @ factor.T
    scale = errors / np.sqrt(np.diag(powers))
    return Identification(name, tuple(estimates), (), powers * np.outer(scale, scale), (), (), (), 1)


@pytest.fixture(scope="module")
def found() -> Identification:
    """An identification of payload and Young's modulus."""
    return identification(np.random.default_rng(4), 2)


@pytest.fixture(scope="module")
def file(found: Identification, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its ``identified.json``."""
    return found.write(tmp_path_factory.mktemp("identified")) / "identified.json"


def test_robots_enclose_what_is_likely() -> None:
    """A linear figure is at the worst robot no better than at the end of its 95 % interval; each parameter reaches its interval's ends."""
    rng = np.random.default_rng(0)
    for number in range(200):
        count, skew = int(rng.integers(1, 4)), 0.4 * (number % 2)
        each = identification(rng, count, skew)
        points = np.array([[*robot.values()] for robot in each.robots(SCENE)])
        values, ends = np.array([*each.values.values()]), np.array([one.interval for one in each.free])
        assert len(points) == 2 * count
        assert np.all(points.min(0) <= ends[:, 0] * (1.0 + 1e-12))
        assert np.all(points.max(0) >= ends[:, 1] * (1.0 - 1e-12))
        if not skew:
            slopes = rng.normal(size=(50, count)) / values
            deviations = np.sqrt(np.einsum("ki,ij,kj->k", slopes, each.covariance, slopes))
            assert np.all(((points - values) @ slopes.T).max(0) >= 1.96 * deviations * (1.0 - 1e-9))


def test_bands_of_a_plan_contain_the_intervals() -> None:
    """Unsymmetrical ones about other values than the scene's, too: the robots that a plan tries lie on both sides."""
    rng, goals = np.random.default_rng(1), goals_of(SCENE)
    for _ in range(50):
        each = identification(rng)
        own = SCENE.replace({"payload.mass": rng.uniform(4.0, 8.0), "effects.damping.ratio": rng.uniform(0.1, 0.15)})
        robots = [
            one.changes(own)
            for one in replace(goals, scene=own, wishes=PlanSection(**each.plan_bands(own))).variations(2)
        ]
        for name, (key, _) in KEYS.items():
            tried = [robot.get(name, own.payload.mass if name == "payload.mass" else None) for robot in robots]
            low, high = each.band(name)
            assert min(filter(None, tried)) <= low * (1.0 + 1e-12), key
            assert max(filter(None, tried)) >= high * (1.0 - 1e-12), key


def test_a_file_has_what_was_found(found: Identification, file: Path) -> None:
    """Bands, robots and draws; `sweep --cases` takes the same draws from both files."""
    read = Identification.read(file)
    assert read.robots(SCENE) == found.robots(SCENE)
    assert band_masses(SCENE, parse_band(str(file))) == found.band("payload.mass")
    table, drawn = (as_cases(path) for path in (file.with_name("draws.csv"), file))
    assert table.keys == drawn.keys == ("payload.mass", "mechanism.material.youngs_modulus")
    np.testing.assert_allclose(np.array(table.rows, float), np.array(drawn.rows, float), rtol=1e-12)


@pytest.mark.slow
def test_margins_are_the_worst_of_single_robots(found: Identification, file: Path) -> None:
    """The controllers don't know the robots: a PD's margins are those of scenes with their parameters."""
    both = flexfmu.margins(LOOP, poses=1, identified=file)
    single = [flexfmu.margins(scene_with_parameters(LOOP, each), poses=1) for each in [{}, *found.robots(LOOP)]]
    expected = [margin_figures(each) for each in single]
    for name, value in margin_figures(both).items():
        worst = max if name == "sensitivity_peak" else min
        assert value == pytest.approx(worst(float(each[name]) for each in expected), rel=1e-9), name
    assert len({row["robot"] for row in both.rows()}) == 5
    assert both.own.poses == both.poses[:1]


@pytest.mark.slow
def test_a_trial_of_a_tuning_is_worth_its_worst_robot(found: Identification) -> None:
    """Metrics of single runs with the robots' parameters, and their margins."""
    robots = found.robots(LOOP)
    study = Study(LOOP, (Interval("pd.kp", 1e3, 1e5),), parse_goal("peak_torque"), robots=tuple(robots))
    peaks = [metrics_of(flexfmu.run(LOOP, parameters=each))["peak_torque_1"] or 0.0 for each in [{}, *robots]]
    assert study.tried(()).figures["peak_torque_1"] == pytest.approx(max(peaks), rel=1e-9)


def test_what_cannot_be_used_is_one_sentence(file: Path, tmp_path: Path) -> None:
    """Another file, a parameter that wasn't identified or that the scene lacks, and intervals that a band can't have."""
    (tmp_path / "summary.json").write_text('{"parameters": {}}')
    (tmp_path / "list.json").write_text("[]")
    found = Identification.read(file)
    replace(found, estimates=found.estimates[1:], covariance=found.covariance[1:, 1:]).write(tmp_path)
    for arguments, words in (
        (["margins", "--identified", tmp_path / "summary.json"], "isn't an identified.json"),
        (["tune", "--identified", tmp_path / "list.json", "--over", "pd.kp=1:2"], "isn't an identified.json"),
        (["plan", "--identified", tmp_path / "none.json"], "No such file"),
        (["sweep", "--cases", tmp_path / "list.json"], "isn't an identified.json"),
        (["plan", "--payload-band", tmp_path / "identified.json"], "no interval of payload.mass"),
        (["plan", "--identified", file, "--set", "mechanism.material.youngs_modulus=2e10"], "stay below 100 %"),
        (["margins", "--identified", file, "--set", "payload.mass=0"], "has no payload.mass"),
    ):
        done = CliRunner().invoke(app, [str(arguments[0]), "barnard2012-6kg", *map(str, arguments[1:])])
        assert done.exit_code == 2, done.output
        assert words in " ".join(done.stderr.split()), done.stderr
        assert "Traceback" not in done.stderr
