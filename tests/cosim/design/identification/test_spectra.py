"""Frequency responses and modes as logs: drawn robots are found again within intervals, and what can't be used is one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexfmu
from flexfmu import FrequencyResponse
from flexfmu.cosim.design.identification.estimate import FreeParameter, Problem
from flexfmu.cosim.design.identification.measurements import Experiment
from flexfmu.cosim.design.identification.spectra import as_spectrum, delay_of_response, spectrum_experiment
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.statics import damped_modes

ROBOT = flexfmu.load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
LOCKED = ROBOT.replace({"cosimulation.drive": "motion"})
END, DELAY, F = (0.175, 0.32), 1.5e-3, np.arange(5.0, 400.0, 5.0)
FREE = [FreeParameter("payload.mass", "kg", 6.0, 0.0), FreeParameter("damping.ratio", "1", 0.1357, 0.0)]
TORQUE, ANGLE = ("joint1.torque",), ("joint1.position",)


def simulated(experiment: Experiment, *values: float) -> list[RealArray]:
    """What its channels show with these parameters."""
    (recording,) = experiment.simulate([{each.name: x for each, x in zip(FREE, values, strict=False)}])
    return [each.simulated(recording, 0.0 if experiment.is_table else DELAY)[0] for each in experiment.channels]


def coverage(experiments: list[Experiment], true: tuple[float, ...], sensors: tuple[str, ...]) -> list[bool]:
    """Whether the interval of each parameter contains the truth."""
    delays = [0.0 if each.is_table else delay_of_response(each, each.simulate([{}])[0]) for each in experiments]
    problem = Problem(experiments, FREE[: len(true)], sensors, delays)
    found, _ = problem.intervals(problem.solve())
    return [low <= x <= high for (low, high), x in zip(found, true, strict=False)]


@pytest.mark.slow
def test_drawn_robots_are_found_from_responses() -> None:
    """Payload and damping from one response with an unknown delay: at least 7 of 8 draws, with errors known up to a factor."""
    inside = np.zeros(2)
    for seed in range(8):
        step = (None, 1e-3)[seed % 2]
        empty = FrequencyResponse(F, np.ones(F.size), TORQUE, ANGLE, sample_time=step)
        model = spectrum_experiment(ROBOT, empty, {}, END, name="r")
        rng = np.random.default_rng(seed)
        true = rng.uniform(4.0, 8.0), rng.uniform(0.05, 0.2)
        real, imaginary = simulated(model, *true)
        error = 0.02 * np.hypot(real, imaginary) * rng.uniform(0.5, 2.0, F.size)
        values = real + 1j * imaginary + error * (rng.normal(size=F.size) + 1j * rng.normal(size=F.size))
        measured = FrequencyResponse(F, values, TORQUE, ANGLE, {}, 3.0 * error, sample_time=step)
        inside += coverage([spectrum_experiment(ROBOT, measured, {}, END, name="r")], true, ("delay", "gain"))
    assert np.all(inside >= 7)


@pytest.mark.slow
def test_drawn_robots_are_found_from_modes() -> None:
    """Payload and damping from two modes with their errors, which aren't taken from the residuals: at least 12 of 14 draws."""
    inside = np.zeros(2)
    for seed in range(14):
        rng = np.random.default_rng(seed)
        true = rng.uniform(4.0, 8.0), rng.uniform(0.05, 0.2)
        table = {"frequency": np.array([50.0, 80.0]), "damping_ratio": np.array([0.02, 0.02])}
        values = simulated(spectrum_experiment(LOCKED, table, {}, END, name="m"), *true)
        for key, share, own in zip(("frequency", "damping_ratio"), (0.003, 0.05), values, strict=True):
            table |= {key: own * (1.0 + share * rng.normal(size=2)), f"{key}_error": share * own}
        experiment = spectrum_experiment(LOCKED, table, {}, END, name="m")
        inside += coverage([experiment], true, ("delay", "offset"))
    assert np.all(inside >= 12)


def test_simulated_modes_are_those_of_the_model() -> None:
    """Those of motors that are locked, by motion drive."""
    modes = damped_modes(LOCKED, motor_angles(LOCKED.mechanism, END))
    table = {"frequency": modes.frequencies[:3], "damping_ratio": modes.ratios[:3]}
    found = simulated(spectrum_experiment(LOCKED, table, {}, None, name="m"))
    np.testing.assert_allclose(found, [*table.values()], rtol=1e-9)


@pytest.mark.slow
def test_logs_of_all_kinds_are_fitted_together(tmp_path: Path) -> None:
    """A response in a file with other names and units, and a table of modes of a part with a known payload."""
    plant = flexfmu.linearize(ROBOT.replace({"payload.mass": 5.0}), END, ["joint1.position"])[:, 0]
    values = 180.0 / np.pi * FrequencyResponse.of(plant, F).response[:, 0, 0] * np.exp(-2j * np.pi * F * DELAY)
    values *= 1.0 + 1e-3 * np.random.default_rng(0).normal(size=F.size)
    FrequencyResponse(F, values, ("M1",), ("angle",)).write(tmp_path / "response.csv")
    free = flexfmu.linearize(ROBOT.replace({"payload.mass": 0.0}), END)
    poles = np.array([each for each in np.linalg.eigvals(free.A) if each.imag > 100.0])
    rows = sorted((abs(each) / (2.0 * np.pi), -each.real / abs(each)) for each in poles.tolist())[:3]
    lines = [f"{1e-3 * f:.6g},{100.0 * ratio:.6g}" for f, ratio in rows]
    (tmp_path / "modes.csv").write_text("\n".join(["frequency [kHz],damping_ratio [%]", *lines]))
    found = flexfmu.identify(
        ROBOT,
        [tmp_path / "response.csv", (tmp_path / "modes.csv", {"payload.mass": 0.0, "pose": [*END]})],
        ["payload.mass", "damping.ratio=0.1"],
        mapping={"M1": "joint1.torque", "angle": "joint1.position*deg"},
        explain=False,
        out=tmp_path / "out",
    )
    assert found.values["payload.mass"] == pytest.approx(5.0, rel=1e-3)
    assert found.values["damping.ratio"] == pytest.approx(0.1357, rel=1e-2)
    assert found.sensors[0].value == pytest.approx(DELAY, abs=1e-5)
    assert "frequency [Hz]" in (tmp_path / "out" / "identified.html").read_text()


def fitted(path: Path) -> None:
    """Read a file and fit it."""
    measured = as_spectrum(path, {})
    assert measured is not None
    coverage([spectrum_experiment(ROBOT, measured, {}, END, name=path.name)], (6.0, 0.1), ())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "frequency,real,imaginary\n1,2,3\n2,3,4\n",
            r"output of bad.csv is 'output'.*--map \"output=joint1.position\"",
        ),
        (
            "f,joint1.position/joint3.torque real,joint1.position/joint3.torque imaginary\n1,2,3\n2,3,4\n",
            "joint3.torque.*did you mean",
        ),
        (
            "frequency,joint1.position/joint1.torque real,joint1.position/joint1.torque imaginary\n1,2,3\n-2,3,4\n",
            "ascend",
        ),
        (
            "frequency,joint1.position/joint1.torque real,joint1.position/joint1.torque imaginary\n1,2,3\n2,nan,4\n",
            "finite at 2 Hz",
        ),
        (
            "frequency,joint1.position/joint1.torque real,joint1.position/joint1.torque imaginary\n1,2,3\n1e6,3,4\n",
            "highest mode",
        ),
        ("frequency,damping_ratio\n20,0.1\n-30,0.1\n", r"line 3: frequency must be above 0, got -30 Hz"),
        ("frequency,damping_ratio\n20,nan\n30,0.1\n", r"line 2: damping_ratio must be above 0, got nan: leave out"),
        ("frequency [V],damping_ratio\n20,0.1\n30,0.1\n", "unit 'V'"),
        ("frequency\n20\n", "2 unknowns and how accurate"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    """It names the file, the column or signal, the value, and what to do."""
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(flexfmu.InputError, match=words) as caught:
        fitted(tmp_path / "bad.csv")
    assert "\n" not in str(caught.value)
