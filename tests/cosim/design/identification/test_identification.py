"""Identification: noise models and least squares against closed forms, intervals by their coverage, and logs that can't be used."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz

import flexfmu
from flexfmu.cosim.design.identification.estimate import FreeParameter, Problem, undetermined
from flexfmu.cosim.design.identification.measurements import (
    Channel,
    Experiment,
    LoggedSignals,
    _distinct,
    noise_of,
    sampled,
)
from flexfmu.cosim.design.identification.noise import ColouredNoise, fitted_noise, independence, whiteness
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray

TIME = np.linspace(0.0, 1.0, 401)


def autoregressive(coefficients: Sequence[float], count: int, rng: np.random.Generator) -> RealArray:
    """Noise of an autoregressive model with white noise of unit variance."""
    values, white = np.zeros(count + 500), rng.normal(size=count + 500)
    for n in range(len(coefficients), values.size):
        values[n] = white[n] + sum(a * values[n - 1 - k] for k, a in enumerate(coefficients))
    return values[500:]


def experiment(signals: Mapping[str, RealArray], simulate: Mapping[str, object]) -> Experiment:
    """An experiment whose simulation is a function of parameters and time for each signal."""
    step = float(TIME[1] - TIME[0])
    channels = tuple(
        Channel(name, "1", {name: 1.0}, TIME, values, (slice(0, TIME.size),), step) for name, values in signals.items()
    )
    fine = np.linspace(-0.2, 1.2, 2801)

    def run(variants: Sequence[Mapping[str, float]]) -> list[Recording]:
        return [
            Recording(fine, {name: Column("1", function(each, fine)) for name, function in simulate.items()})  # type: ignore[operator]
            for each in variants
        ]

    return Experiment("log", channels, run, 1.2, True)


def test_whitening_is_the_exact_factor_of_the_covariance() -> None:
    """W S W' = 1 for the autocovariance S of a model of second order, its first samples included."""
    a = np.array([1.2, -0.5])
    # reflection coefficients of the model give the predictors of lower orders
    first = a[0] / (1.0 - a[1])
    power = 1.0 / ((1.0 - a[1] ** 2) * (1.0 - first**2))
    deviations = np.sqrt([power, power * (1.0 - first**2), 1.0])
    noise = ColouredNoise((np.zeros(0), np.array([first]), a), deviations, 1e-3)
    covariance = [power, first * power]
    for _ in range(38):
        covariance.append(a[0] * covariance[-1] + a[1] * covariance[-2])
    operator = noise.whitened(np.eye(40), [slice(0, 40)])
    np.testing.assert_allclose(operator @ toeplitz(covariance) @ operator.T, np.eye(40), atol=1e-12)


def test_the_noise_of_a_model_is_found_again() -> None:
    """Poles, deviation and order from 4,000 samples in three pieces."""
    values = autoregressive([1.6, -0.9], 4000, np.random.default_rng(1))
    pieces = [slice(0, 1500), slice(1500, 1600), slice(1600, 4000)]
    noise = fitted_noise(values, pieces, 1e-3)
    assert noise.deviations[-1] == pytest.approx(1.0, rel=0.05)
    assert 2 <= noise.order <= 6
    frequency, damping = noise.resonances[0]
    pole = np.log(np.roots([1.0, -1.6, 0.9])[0]) / 1e-3
    assert frequency == pytest.approx(abs(pole) / (2.0 * np.pi), rel=0.02)
    assert damping == pytest.approx(-pole.real / abs(pole), rel=0.3)
    white = noise.whitened(values, pieces)
    assert whiteness(white, pieces) > 1e-3 > whiteness(values, pieces)


def test_residuals_that_depend_on_the_motion_are_told() -> None:
    """The probability is uniform for noise alone, tiny for a hundredth of the motion in it."""
    rng, motion = np.random.default_rng(2), np.sin(40.0 * TIME)
    found = [independence(rng.normal(size=401), motion[:, None], 2) for _ in range(300)]
    assert np.quantile(found, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.08)
    assert independence(rng.normal(size=401) + 0.6 * motion, motion[:, None], 2) < 1e-6


def test_signals_between_points_follow_their_derivatives() -> None:
    """Quintic between points, right limits at jumps, constant beyond the ends."""
    points = np.array([0.0, 0.1, 0.25, 0.25, 0.5])
    jump = np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    column = Column("1", points**5 + jump, 5.0 * points**4, 20.0 * points**3)
    time = np.array([-1.0, 0.05, 0.24, 0.25, 0.4, 9.0])
    value, slope = sampled(points, column, time)
    np.testing.assert_allclose(value, np.clip(time, 0.0, 0.5) ** 5 + (time >= 0.25), atol=1e-14)
    np.testing.assert_allclose(slope, np.where((time < 0.0) | (time > 0.5), 0.0, 5.0 * time**4), atol=1e-12)


def test_noise_of_angles_is_that_of_their_encoder() -> None:
    """A smooth motion, rounded: the noise is that of rounding, a 12th of a square."""
    assert noise_of(1e-4 * np.round(np.sin(6.0 * TIME) / 1e-4)) == pytest.approx(1e-4 / np.sqrt(12.0), rel=0.15)


def test_rounding_at_rest_counts_once() -> None:
    """Of many equal values in a row the middle one stays, all others do; the rest's rounding isn't biased by the slow ends."""
    ends = 0.5 * (1.0 - np.cos(np.pi * TIME))
    kept = _distinct(np.round(ends / 1e-2))
    assert np.flatnonzero(kept)[[0, -1]] == pytest.approx([9, 391], abs=2)
    assert kept[100:300].all()
    assert np.abs(np.round(ends / 1e-2) * 1e-2 - ends)[kept].mean() == pytest.approx(2.5e-3, rel=0.2)


def test_noise_of_what_drives_a_simulation_is_in_the_errors() -> None:
    """A gain from input to output: the input's noise, in the simulation alone, moves the gain's estimate as the closed form says."""
    rng, deviation = np.random.default_rng(5), 0.02
    true = np.sin(9.0 * TIME) + 0.3 * np.sin(50.0 * TIME)
    drive = LoggedSignals("log", {"u": ""}, TIME, (true + deviation * rng.normal(size=TIME.size))[None])
    assert drive.noise[0] == pytest.approx(deviation, rel=0.2)
    exact = experiment({"y": 2.0 * true + 0.2 * rng.normal(size=TIME.size)}, {})

    def run(variants: Sequence[Mapping[str, float]]) -> list[Recording]:
        drive.prepare(TIME)
        table = drive.announced
        return [
            Recording(TIME, {"y": Column("", each["a"] * table[:, 0, 0], each["a"] * table[:, 1, 0])})
            for each in variants
        ]

    problem = Problem(
        [replace(exact, simulate=run, drive=drive, stop_time=1.0)], [FreeParameter("a", "1", 1.5)], (), [0.0]
    )
    found = problem.solve()
    spread = np.mean([np.sqrt(problem.driven(found, seed)[0, 0]) for seed in range(8)])
    power = float(np.sum(true**2) + TIME.size * deviation**2)
    assert spread == pytest.approx(found.unknowns[0] * drive.noise[0] / np.sqrt(power), rel=0.15)


def test_a_linear_problem_has_the_solution_of_the_normal_equations() -> None:
    """White noise: values, and standard errors within those that are robust."""
    rng = np.random.default_rng(3)
    basis = np.column_stack([np.sin(20.0 * TIME), np.cos(13.0 * TIME)])
    measured = basis @ [2.0, 3.0] + 0.1 * rng.normal(size=TIME.size)

    def function(each: Mapping[str, float], time: RealArray) -> RealArray:
        return each["a"] * np.sin(20.0 * time) + each["b"] * np.cos(13.0 * time)

    log = experiment({"y": measured}, {"y": function})
    problem = Problem([log], [FreeParameter("a", "1", 1.0), FreeParameter("b", "1", 1.0)], (), [0.0])
    noise = problem.noises(problem.fit(problem.start, problem.first_noises(problem.start)))
    white = [ColouredNoise((np.zeros(0),), noise[0].deviations[:1], noise[0].step)]
    found = problem.fit(problem.start, white)
    expected, rest, *_ = np.linalg.lstsq(basis, measured, rcond=None)
    np.testing.assert_allclose(found.unknowns, expected, atol=2e-4)
    errors = np.sqrt(rest[0] / 399.0 * np.diag(np.linalg.inv(basis.T @ basis)))
    ratio = np.sqrt(np.diag(found.covariance)) / errors
    assert np.all(ratio > 0.97)
    assert np.all(ratio < 1.5)


def test_intervals_contain_the_truth_as_often_as_they_say() -> None:
    """An amplitude, a rate, an unknown delay and offset under coloured noise: 90 to 99.5 % of 200 draws."""

    def function(each: Mapping[str, float], time: RealArray) -> RealArray:
        return each["amplitude"] * np.exp(-each["rate"] * np.maximum(time, 0.0)) * np.sin(40.0 * time)

    inside = np.zeros(2)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = {"amplitude": rng.uniform(1.0, 3.0), "rate": rng.uniform(1.0, 4.0)}
        noise = autoregressive([rng.uniform(0.3, 0.9)], TIME.size, rng)
        log = experiment({"y": function(true, TIME - 0.004) + 0.3 + 0.03 * noise}, {"y": function})
        free = [FreeParameter("amplitude", "1", 2.0), FreeParameter("rate", "1", 2.0, 0.0)]
        problem = Problem([log], free, ("delay", "offset"), [0.0])
        found, _ = problem.intervals(problem.solve())
        inside += [low <= true[each.name] <= high for each, (low, high) in zip(free, found, strict=False)]
    assert np.all(inside >= 180)
    assert np.all(inside <= 199)


def test_intervals_from_tables_of_few_rows_contain_the_truth() -> None:
    """Two metrics with errors of different size in 6 runs each: 87 to 99 % of 80 draws."""
    place, inside = np.arange(6.0), np.zeros(2)
    pieces = tuple(slice(k, k + 1) for k in range(6))
    free = [FreeParameter("a", "1", 0.9), FreeParameter("b", "1", 2.2)]
    for seed in range(80):
        rng = np.random.default_rng(seed)
        factors, sizes = rng.normal(size=(2, 6, 2)), rng.uniform(0.02, 0.2, 2)

        def run(variants: Sequence[Mapping[str, float]], factors: RealArray = factors) -> list[Recording]:
            linear = [factors @ [each["a"], each["b"]] for each in variants]
            return [
                Recording(place, {f"m{k}": Column("1", x + 0.05 * x**2) for k, x in enumerate(each)}) for each in linear
            ]

        exact = run([{"a": 1.0, "b": 2.0}])[0]
        values = [exact[f"m{k}"].values + size * rng.normal(size=6) for k, size in enumerate(sizes)]
        channels = tuple(
            Channel(f"m{k}", "1", {f"m{k}": 1.0}, place, each, pieces, 1.0, axis="row") for k, each in enumerate(values)
        )
        problem = Problem([Experiment("table", channels, run, 12.0, True, is_table=True)], free, (), [0.0])
        found, _ = problem.intervals(problem.solve())
        inside += [low <= true <= high for true, (low, high) in zip((1.0, 2.0), found, strict=True)]
    assert np.all(inside >= 0.87 * 80)
    assert np.all(inside <= 0.99 * 80)


def test_an_interval_that_is_no_parabola_is_that_of_the_profile() -> None:
    """Few and noisy values of a decay: the ends are where the sum of squares has grown by the square of the quantile."""
    rng = np.random.default_rng(5)
    measured = np.exp(-9.0 * TIME) + 0.4 * rng.normal(size=TIME.size)

    def function(each: Mapping[str, float], time: RealArray) -> RealArray:
        return np.exp(-each["rate"] * time)

    log = experiment({"y": measured}, {"y": function})
    problem = Problem([log], [FreeParameter("rate", "1", 5.0, 0.0)], (), [0.0])
    found = problem.fit(problem.start, [ColouredNoise((np.zeros(0),), np.array([0.4]), 2.5e-3)])
    ((low, high),), profiled = problem.intervals(found)
    assert profiled == [0]
    error = float(np.sqrt(found.covariance[0, 0]))
    scaled = float((found.jacobian**2).sum()) * (1.966 * error) ** 2
    for end in (low, high):
        cost = float((((measured - np.exp(-end * TIME)) / 0.4) ** 2).sum())
        assert cost - found.cost == pytest.approx(scaled, rel=0.15)
    assert high - found.unknowns[0] > 1.1 * (found.unknowns[0] - low)


def test_what_cannot_be_told_apart_is_named() -> None:
    """A sum and a product of parameters, and one that has no influence."""

    def function(each: Mapping[str, float], time: RealArray) -> RealArray:
        return (each["a"] + each["b"]) * np.sin(20.0 * time) + each["c"] * np.cos(13.0 * time)

    log = experiment({"y": 2.0 * np.sin(20.0 * TIME) + np.cos(13.0 * TIME)}, {"y": function})
    free = [FreeParameter(name, "1", 1.5) for name in "abcd"]
    problem = Problem([log], free, (), [0.0])
    noises = [ColouredNoise((np.zeros(0),), np.array([0.1]), 2.5e-3)]
    unclear = undetermined(problem, problem.fit(problem.start, noises))
    assert {free[key].name: [free[i].name for i in others] for key, others in unclear.items()} in (
        {"a": ["b"], "d": []},
        {"b": ["a"], "d": []},
    )


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Torques of the 6 kg scene with 5.5 kg at 1 kHz, 1 % of noise, 3 ms late."""
    run, rng = flexfmu.run("barnard2012-6kg", parameters={"payload.mass": 5.5}), np.random.default_rng(0)
    time, path = np.arange(0.0, 0.67, 1e-3), tmp_path_factory.mktemp("log") / "log.csv"
    columns = [time]
    for name in ("joint1.torque", "joint2.torque"):
        values = np.interp(time - 3e-3, run.recording.time, run.recording[name].values)
        columns.append(values + 0.01 * np.abs(values).max() * rng.normal(size=time.size))
    header = "time,joint1.torque,joint2.torque"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


def test_a_payload_is_found_from_torques(log: Path, tmp_path: Path) -> None:
    """To 0.5 %, with its interval, the delay, and files for the next commands."""
    found = flexfmu.identify("barnard2012-6kg", log, ["payload.mass"], out=tmp_path)
    (mass,) = found.estimates
    assert mass.value == pytest.approx(5.5, rel=5e-3)
    assert mass.interval[0] < 5.5 < mass.interval[1]
    assert found.sensors[0].value == pytest.approx(3e-3, abs=2e-4)
    assert found.is_explained
    assert found.scene is not None
    assert found.scene.payload.mass == mass.value
    assert found.band("payload.mass") == mass.interval
    assert all(abs(each["payload.mass"] - mass.value) < 6.0 * mass.standard_error for each in found.draws())
    assert {each.name for each in tmp_path.iterdir()} == {"identified.html", "identified.json", "draws.csv"}
    assert "payload.mass = 5." in repr(found)
    # the page begins with what was found
    page, (before, after) = found.page(), found.signals[0].rms
    assert re.search(r'<p class="verdict">payload.mass is 5\.[\d]+ ± \S+ kg; joint\d.torque, RMS of measured', page)
    assert "payload.mass, 6 before" in page
    assert after < before
    assert ", worse" not in page
    signal = replace(found.signals[0], before=found.signals[0].after, after=found.signals[0].before)
    assert f'class="over">{after:.4g} → {before:.4g} N·m, worse</span>' in replace(found, signals=(signal,)).page()


def test_drawn_starts_end_at_one_minimum(log: Path) -> None:
    """Within half and twice the first values, far from the minimum of whitened residuals; a first value out of range is an error."""
    found = flexfmu.identify("barnard2012-6kg", log, ["payload.mass", "damping.ratio"], starts=4, explain=False)
    assert found.messages[0] == "4 of 4 starts end at the same values."
    assert found.values["payload.mass"] == pytest.approx(5.5, rel=5e-3)
    with pytest.raises(flexfmu.Error, match=r"payload\.mass must be at least 0 kg and at most"):
        flexfmu.identify("barnard2012-6kg", log, {"payload.mass": -1.0})


@pytest.mark.slow
def test_proposed_motions_have_the_errors_of_their_logs(log: Path, tmp_path: Path) -> None:
    """Those of the scene's own motion are those that a log of it gives; the best is at least as good, and its scene runs."""
    found = flexfmu.identify("barnard2012-6kg", log, ["payload.mass=5.5"])
    proposed = flexfmu.propose_motions("barnard2012-6kg", ["payload.mass=5.5"])
    error = found.estimates[0].standard_error
    assert proposed.own.errors["payload.mass"] == pytest.approx(error, rel=0.25)
    assert proposed.best.is_allowed
    assert proposed.best.figure <= proposed.own.figure
    run = flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace({**proposed.best.changes, "payload.mass": 5.5}))
    assert run.metrics.peak_torque_1.value == pytest.approx(proposed.best.torque, rel=1e-3) or (
        run.metrics.peak_torque_2.value == pytest.approx(proposed.best.torque, rel=1e-3)
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda lines: [lines[0].replace("joint1.torque", "a").replace("joint2.torque", "b"), *lines[1:]],
            "is a signal",
        ),
        (lambda lines: [lines[0], *lines[1:300][::-1]], "must not decrease"),
        (lambda lines: lines[:6], "at least 8"),
        (lambda lines: [lines[0].replace("joint1.torque", "joint1.torque [V]"), *lines[1:]], "unknown unit"),
        (
            lambda lines: [lines[0], *(f"{a},{1e3 * float(b)},{c}" for a, b, c in (x.split(",") for x in lines[1:]))],
            "times as large",
        ),
        (lambda lines: [lines[0], *(f"{a},{c},{b}" for a, b, c in (x.split(",") for x in lines[1:]))], "of this robot"),
        (lambda lines: [lines[0].replace("joint2", "joint1"), *lines[1:]], "there twice"),
    ],
    ids=["columns", "unsorted", "short", "unit", "scale", "robot", "twice"],
)
def test_a_log_that_cannot_be_used_is_one_sentence(log: Path, tmp_path: Path, change: object, words: str) -> None:
    """It names what is wrong, and what to do."""
    lines = change(log.read_text().splitlines())  # type: ignore[operator]
    (tmp_path / "bad.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(flexfmu.Error, match=words) as caught:
        flexfmu.identify("barnard2012-6kg", tmp_path / "bad.csv", ["payload.mass"])
    assert "\n" not in str(caught.value)


def test_gaps_and_missing_values_are_left_out(log: Path, tmp_path: Path) -> None:
    """Without 100 rows, with cells that are no numbers, and with a repeated instant."""
    lines = log.read_text().splitlines()
    cells = lines[500].split(",")
    lines[500] = f"{cells[0]},nan,{cells[2]}"
    path = tmp_path / "gaps.csv"
    path.write_text("\n".join([*lines[:200], *lines[300:], lines[-1]]) + "\n")
    with pytest.warns(UserWarning, match="repeated|no finite"):
        found = flexfmu.identify("barnard2012-6kg", path, ["payload.mass"])
    (mass,) = found.estimates
    assert mass.interval[0] < 5.5 < mass.interval[1]


def test_wrong_keys_are_one_sentence(log: Path) -> None:
    """Keys that don't exist, are 0, are free twice, or have wrong bounds."""
    for free, words in {
        "payload.mas": "payload.mass",
        "motor_inertia": "give a first value",
        "payload.mass,payload.mass": "free twice",
        "payload.mass=9:3": "must ascend",
        "": "nothing is free",
    }.items():
        with pytest.raises(flexfmu.InputError, match=words):
            flexfmu.identify("barnard2012-6kg", log, free)
    with pytest.raises(flexfmu.InputError, match="sensors"):
        flexfmu.identify("barnard2012-6kg", log, ["payload.mass"], sensors=["drift"])
