"""Frequency responses from logs and files: errors that hold, modes that are found again, and margins that are those of the model."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import lfilter
from typer.testing import CliRunner

import flexfmu
from flexfmu import FrequencyResponse
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import DataWarning, InputError
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.trajectories.jets import RealArray

H = 1e-3


def two_modes(first: tuple[float, float], second: tuple[float, float]) -> control.StateSpace:
    """A plant with two modes (frequency [Hz], damping ratio)."""
    terms = [control.tf([1e-3 * (w := 2.0 * np.pi * f) ** 2], [1.0, 2.0 * z * w, w**2]) for f, z in (first, second)]
    return control.ss(terms[0] + 0.5 * terms[1])


PLANT = two_modes((20.0, 0.03), (75.0, 0.015))
SAMPLED = control.sample_system(PLANT, H)
CONTROLLER = control.ss(control.tf([200.0, -150.0], [1.0, -0.2], H))
INSIDE = control.feedback(1, SAMPLED * CONTROLLER)


def filtered(system: control.StateSpace, values: RealArray) -> RealArray:
    """What a sampled system answers."""
    found = control.tf(system)
    num, den = found.num_array[0, 0], found.den_array[0, 0]
    return np.asarray(lfilter(np.pad(num, (len(den) - len(num), 0)), den, values))


def closed_loop(excitation: RealArray, noise: float, seed: int) -> Recording:
    """A log of the plant in a loop with torques from the controller and an excitation, and coloured noise of the position."""
    v = noise * lfilter([1.0], [1.0, -0.7], np.random.default_rng(1000 + seed).standard_normal(len(excitation)))
    torque = filtered(INSIDE, excitation - filtered(CONTROLLER, v))
    t, position = H * np.arange(len(excitation)), filtered(SAMPLED, torque) + v
    columns = {"u": Column("N.m", torque), "y": Column("rad", position), "d": Column("N.m", excitation)}
    return Recording(t, columns)


def multisine(periods: int) -> RealArray:
    """Schroeder's phases, every 2 Hz, a period of 2 s."""
    k = np.arange(4, 400, 4)
    t = np.arange(2000) / 2000
    one = np.cos(2.0 * np.pi * k * t[:, np.newaxis] - np.pi * np.arange(len(k)) ** 2 / len(k)).sum(axis=1)
    return np.tile(one / one.std(), periods)


@pytest.mark.parametrize("way", ["periodic", "reference"])
def test_standard_errors_hold_in_a_closed_loop(way: str) -> None:
    """Of 10 logs, misses relative to the standard errors have the size of 1, in the middle of the band within 10 %."""
    noise = np.random.default_rng(0).standard_normal(20000)
    options: Any = {"period": 2.0} if way == "periodic" else {"segment": 2.0, "reference": "d", "band": (30.0, 60.0)}
    misses = []
    for seed in range(10):
        log = closed_loop(multisine(6) if way == "periodic" else noise, 2e-5, seed)
        found = flexfmu.frequency_response(log, "u", "y", **options)
        miss = (found.response - FrequencyResponse.of(SAMPLED, found.frequency).response) / found.standard_error
        misses += [miss.real, miss.imag]
    assert found.sample_time == pytest.approx(H)
    assert found.coherence is not None
    assert found.coherence.min() > 0.3
    assert 0.85 < float(np.std(misses)) < 1.2
    assert np.abs(np.mean(misses)) < 0.1


def test_the_command_estimates_a_response(tmp_path: Path) -> None:
    """Of a log in a file; with the number of modes that it has, though none is given."""
    closed_loop(multisine(4), 2e-5, 0).write(tmp_path / "log.csv")
    options = [
        "--map",
        "u=M1*1",
        "--input",
        "M1",
        "--output",
        "y",
        "--period",
        "2",
        "--between",
        "0:9",
        "--band",
        "1:150",
        "--json",
    ]
    result = CliRunner().invoke(app, ["response", str(tmp_path / "log.csv"), *options])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert [each["frequency"] for each in found["modes"]] == pytest.approx([20.0, 75.0], rel=2e-3)
    assert [each["damping_ratio"] for each in found["modes"]] == pytest.approx([0.03, 0.015], rel=0.1)
    assert found["sample_time"] == pytest.approx(H)
    assert len(found["response"]) == 75


def test_files_of_others_are_read(tmp_path: Path) -> None:
    """CSV in several forms, arrays of idfrd in a file and in a struct, and python-control's."""
    wanted = FrequencyResponse.of(PLANT, np.geomspace(1.0, 200.0, 40))
    value, f = wanted.response[:, 0, 0], wanted.frequency
    files = {
        "a.csv": (
            "frequency [Hz],magnitude [dB],phase [deg]",
            (f, 20.0 * np.log10(np.abs(value)), np.degrees(np.angle(value))),
        ),
        "b.csv": ("omega;mag;phase [rad]", (2.0 * np.pi * f, np.abs(value), np.angle(value))),
        "c.csv": ("Frequency [rad/s]\tReal\tImag", (2.0 * np.pi * f, value.real, value.imag)),
    }
    for name, (head, columns) in files.items():
        separator = next(each for each in ";\t," if each in head)
        rows = [separator.join(map(repr, row)) for row in np.column_stack(columns).tolist()]
        (tmp_path / name).write_text("\n".join([head, *rows]), encoding="utf-8")
    data = value[np.newaxis, np.newaxis]
    idfrd = {"ResponseData": data, "Frequency": 2.0 * np.pi * f, "FrequencyUnit": "rad/TimeUnit", "Ts": 0.0}
    savemat(tmp_path / "d.mat", idfrd)
    savemat(tmp_path / "e.mat", {"G": idfrd, "other": 1.0})
    frd = control.frequency_response(PLANT, 2.0 * np.pi * f)
    savemat(tmp_path / "f.mat", {"fresp": frd.frdata, "omega": frd.omega})
    for file in sorted(tmp_path.iterdir()):
        found = FrequencyResponse.read(file, inputs=["u"], outputs=["y"])
        np.testing.assert_allclose(found.frequency, f, rtol=1e-12)
        np.testing.assert_allclose(found.response, wanted.response, rtol=1e-10)
        assert (found.inputs, found.outputs, found.sample_time) == (("u",), ("y",), None)


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_written_responses_are_read_again(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(0)
    names = ("joint1.torque", "joint2.torque"), ("joint1.position", "joint2.position", "joint1.velocity")
    values, errors, coherence = (
        rng.standard_normal((8, 3, 2)) * (1.0 + 2.0j),
        rng.uniform(0.0, 1.0, (8, 3, 2)),
        rng.uniform(0.0, 1.0, (8, 3)),
    )
    wanted = FrequencyResponse(np.arange(1.0, 9.0), values, *names, {}, errors, coherence, 2e-4)
    found = FrequencyResponse.read(wanted.write(tmp_path / f"response{suffix}"))
    assert (found.inputs, found.outputs, found.sample_time) == (*names, 2e-4)
    for name in ("frequency", "response", "standard_error", "coherence"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f,x\n1,2\n2,3", "no response of each"),
        ("magnitude,phase [deg]\n1,2\n2,3", "no column `frequency`"),
        ("f,mag,phase\n1,2,3\n2,3,4", r"phase has the unit ''.*phase \[rad\]"),
        ("f,real,imag\n2,2,3\n1,3,4", "ascend"),
        ("f,real,imag\n1,2,3\n2,,4", "isn't finite at 2 Hz"),
    ],
)
def test_bad_files_are_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.csv").write_text(text, encoding="utf-8")
    with pytest.raises(flexfmu.InputError, match=message):
        FrequencyResponse.read(tmp_path / "bad.csv")


def test_bad_logs_are_one_sentence() -> None:
    good = closed_loop(multisine(3), 0.0, 0)
    still = Recording(good.time, {**good.columns, "u": Column("N.m", np.ones(len(good.time)))})
    gap = np.where(np.arange(len(good.time)) == 77, np.nan, good["y"].values)
    for log, options, message in (
        (good, {"period": 3.0}, "at least 2 more"),
        (good, {"band": (600.0, 700.0)}, "excites nothing between 600"),
        (still, {}, "excites nothing"),
        (Recording(good.time, {**good.columns, "y": Column("rad", gap)}), {}, "y has no number at 0.077 s"),
    ):
        with pytest.raises(InputError, match=message):
            flexfmu.frequency_response(log, "u", "y", **options)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="torque"):
        flexfmu.frequency_response(good, "torque", "y")


def test_uneven_steps_are_resampled() -> None:
    t = np.arange(0.0, 8.0, H) + np.random.default_rng(0).uniform(-2e-4, 2e-4, 8000)
    u = np.sin(2.0 * np.pi * 5.0 * t) + np.sin(2.0 * np.pi * 8.0 * t)
    log = Recording(t, {"u": Column("1", u), "y": Column("1", 2.0 * u)})
    with pytest.warns(DataWarning, match="resampled at 0.999"):
        found = flexfmu.frequency_response(log, "u", "y", period=1.0)
    assert found.sample_time is None
    np.testing.assert_allclose(found.frequency, [5.0, 8.0], rtol=1e-4)
    np.testing.assert_allclose(found.response[:, 0, 0], 2.0, rtol=1e-6)


@pytest.mark.slow
def test_intervals_of_modes_cover_them() -> None:
    """Of 40 drawn plants with noise 90 to 99 of 100 intervals hold frequencies and damping ratios, with the number of modes given."""
    rng, inside = np.random.default_rng(5), []
    f = np.geomspace(2.0, 200.0, 120)
    for _ in range(40):
        truth = [(rng.uniform(8.0, 30.0), rng.uniform(0.01, 0.1)), (rng.uniform(50.0, 120.0), rng.uniform(0.01, 0.1))]
        exact = FrequencyResponse.of(two_modes(*truth), f).response
        error = 0.02 * np.abs(exact) + 1e-5
        noise = error * (rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape))
        found = FrequencyResponse(f, exact + noise, standard_error=error).modes(2)
        assert found.misfit == pytest.approx(1.0, abs=0.25)
        for mode, (frequency, ratio) in zip(found.modes, truth, strict=True):
            for value, (low, high) in ((frequency, mode.frequency_interval), (ratio, mode.damping_interval)):
                inside.append(low <= value <= high)
    assert 0.90 <= np.mean(inside) <= 0.99


def test_margins_of_a_loops_response_are_those_of_python_control() -> None:
    loop = FrequencyResponse.of(SAMPLED * CONTROLLER, np.geomspace(1.0, 499.0, 800))
    gain, phase, _, _, crossover, _ = control.stability_margins(loop.to_control())
    found = loop.margins()
    assert found.gain_margin == pytest.approx(gain, rel=1e-5)
    assert found.phase_margin == pytest.approx(np.radians(phase), rel=1e-4)
    assert found.crossover == pytest.approx(crossover, rel=1e-3)


@pytest.mark.slow
def test_standard_errors_of_margins_hold() -> None:
    """Of 40 responses with errors of 1 %, at least 85 of 100 margins lie within 1.96 standard errors of the true ones, whose misses have their size."""
    exact, rng = FrequencyResponse.of(SAMPLED * CONTROLLER, np.geomspace(1.0, 499.0, 150)), np.random.default_rng(3)
    error, true = 0.01 * np.abs(exact.response), exact.margins()
    drawn = []
    for _ in range(40):
        noise = error * (rng.standard_normal(error.shape) + 1j * rng.standard_normal(error.shape))
        drawn.append(replace(exact, response=exact.response + noise, standard_error=error).margins())
    for name in ("gain_margin", "phase_margin", "delay_margin", "disk_margin", "sensitivity_peak", "crossover"):
        misses = np.array([(getattr(each, name) - getattr(true, name)) / getattr(each, name).error for each in drawn])
        assert np.mean(np.abs(misses) < 1.96) >= 0.85, name
        assert 0.6 < misses.std() < 1.35, name
