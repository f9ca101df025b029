"""Runs from memory, folders and files side by side, and a measurement of one of them, whose delay is found within its stated error; scenes
with their processor times, and with payloads that the loops don't know."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from command_line import flexfmu as command
from scipy.signal import lfilter

import flexfmu
from flexfmu.cosim.design.gains.robustness import band_masses, parse_band
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import file_digest
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.measured import TimedValues, correlation, difference, estimate_delay
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import measure_run, metrics_of
from flexfmu.cosim.reports.summary import summarise
from flexfmu.cosim.studies.compare.comparison import Comparison
from flexfmu.model.scene.errors import SceneError

MakeRun = Callable[..., Run]
DELAY = 3.0123456


@pytest.fixture
def run(make_run: MakeRun) -> Run:
    """A run without a dwell, whose metrics need no equilibrium."""
    return make_run(changes={"trajectory.dwell": 0.0})


@pytest.fixture
def folder(run: Run, tmp_path: Path) -> Path:
    """Its folder of results, as `flexfmu run` writes it, called "stored"."""
    path = tmp_path / "stored"
    run.recording.write(path / "results.csv")
    summary = {**summarise(run, measure_run(run)), "results": {"results.csv": file_digest(path / "results.csv")}}
    (path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return path


@pytest.fixture
def log(run: Run, tmp_path: Path) -> Path:
    """Torque 1 of the run in mN.m, offset by 2 N.m, with noise, late by `DELAY`."""
    time, torque = run.recording.time, run.recording["joint1.torque"].values
    sampled = 2.5 + np.arange(1500) * 1e-3
    values = np.interp(sampled - DELAY, time, torque) + 2.0 + 0.05 * np.random.default_rng(1).standard_normal(1500)
    path = tmp_path / "log.csv"
    rows = "".join(f"{t!r},{1e3 * y!r}\n" for t, y in zip(sampled.tolist(), values.tolist(), strict=True))
    path.write_text(f"time,tau\n{rows}", encoding="utf-8")
    return path


def test_every_kind_of_source_is_the_same_run(run: Run, folder: Path, tmp_path: Path) -> None:
    """Memory, folder and file have equal signals, and metrics where there is a summary; names differ."""
    alone = run.write(tmp_path / "alone.parquet")
    found = flexfmu.compare(run, folder, folder / "results.csv", str(alone))
    assert [each.name for each in found.runs] == ["barnard2012-6kg", "stored", "stored (2)", "alone"]
    for each in found.runs:
        np.testing.assert_array_equal(each.recording["joint1.torque"].values, run.recording["joint1.torque"].values)
        assert each.recording["joint1.torque"].unit == "N.m"
    frame = found.to_pandas()
    np.testing.assert_array_equal(frame["stored"], frame["barnard2012-6kg"])
    assert frame.loc["peak_torque_1", "stored"] == run.metrics.peak_torque_1
    assert frame.attrs["units"]["peak_torque_1"] == "N.m"
    assert found.runs[1].duration == pytest.approx(run.plan.duration)
    assert repr(found.runs[1].metrics["peak_torque_1"]).endswith(" N·m")
    assert not found.runs[3].metrics


def test_a_measurement_is_aligned_and_compared(run: Run, log: Path) -> None:
    """The delay within its stated error, and the offset and noise that were added."""
    # another run with nine tenths of the torque
    torque = run.recording["joint1.torque"]
    parts = (0.9 * each for each in (torque.values, torque.first, torque.second) if each is not None)
    other = replace(run, recording=run.recording.with_columns({"joint1.torque": Column("N.m", *parts)}))
    found = flexfmu.compare(run, other, measured=log, mapping={"tau": "joint1.torque*1e-3"}).measured
    assert found is not None
    delay = found.delay
    assert delay.error < 2e-5
    assert delay.seconds == pytest.approx(DELAY, abs=4.0 * delay.error)
    mine = found.differences["barnard2012-6kg"]["joint1.torque"]
    assert mine.mean == pytest.approx(2.0, abs=0.01)
    assert np.sqrt(mine.root_mean_square**2 - mine.mean**2) == pytest.approx(0.05, rel=0.15)
    assert found.differences["barnard2012-6kg (2)"]["joint1.torque"].root_mean_square > mine.root_mean_square
    shown = flexfmu.compare(run, measured=log, mapping={"tau": "joint1.torque*1e-3"})
    assert len(repr(shown).splitlines()) <= 5
    assert "joint1.torque: " in repr(shown)
    assert "<td>Peak torque, joint 1</td>" in shown._repr_html_()
    frame = pandas.read_csv(log).set_index("time").rename(columns={"tau": "joint1.torque"}) * 1e-3
    for source in (
        frame,
        frame.reset_index(),
        Recording(np.array(frame.index), {"joint1.torque": Column("", np.array(frame["joint1.torque"]))}),
    ):
        again = flexfmu.compare(run, measured=source).measured
        assert again is not None
        assert again.delay.seconds == pytest.approx(delay.seconds, abs=1e-9)
    given = flexfmu.compare(run, measured=log, mapping={"tau": "joint1.torque*1e-3"}, delay=DELAY).measured
    assert given is not None
    assert (given.delay.seconds, given.delay.error) == (DELAY, 0.0)


def test_the_command_prints_tables_json_and_a_page(folder: Path, log: Path, tmp_path: Path) -> None:
    """The same figures in the table, the JSON and the page; no line is wider than it must be."""
    options = "--measured", log, "--map", "tau=joint1.torque*1e-3"
    shown = command("compare", folder, folder, *options, "--out", tmp_path / "page")
    assert shown.exit_code == 0, shown.output
    assert "Peak torque, joint 1" in shown.stdout
    assert "(+0 %)" in shown.stdout
    assert f"log is {DELAY:.5f}"[:-1] in shown.stdout
    assert max(map(len, shown.stdout.splitlines()[:20])) <= 80
    data = json.loads(command("compare", folder, folder, *options, "--json").stdout)
    assert data == json.loads((tmp_path / "page" / "comparison.json").read_text(encoding="utf-8"))
    signal = data["measured"]["signals"]["stored"]["joint1.torque"]
    assert f"{signal['rms']:.4g}" in shown.stdout
    page = (tmp_path / "page" / "comparison.html").read_text(encoding="utf-8")
    assert f"{signal['rms']:.4g} N·m" in page
    assert "Spectrum of joint1.torque" in page
    assert len(page.encode()) < 1.5e6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["."], "has no results.csv"),
        (["soft=nothing"], "no scene file 'nothing'"),
        (["--map", "tau=joint1.torque"], "goes with a measurement"),
        (["--measured", "nothing.csv"], "there is no file nothing.csv"),
        (["--map", "tau"], "--map takes MEASURED=SIGNAL"),
        (["a b=barnard2012-6kg"], "`name`"),
        (["barnard2012-6kg", "--variant", "stiff"], "--variant takes NAME:KEY=VALUE"),
        (["barnard2012-6kg", "--variant", "a:payload.mas=1"], "did you mean `mass`"),
        (["barnard2012-6kg", "--variant", "a:payload.mass=1,"], "empty or unfinished value"),
        (["barnard2012-6kg", "--payload-band", "wide"], "two masses in kg"),
        (["barnard2012-6kg", "--payload-band", "1.5"], "above 0 and below 1"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str], message: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit status 2, and nothing is simulated."""
    monkeypatch.chdir(tmp_path)
    result = command("compare", *([folder, *arguments] if arguments[0].startswith("--m") else arguments))
    assert (result.exit_code, message in result.stderr, result.stderr.count("\n")) == (2, True, 1), result.stderr


def test_what_cannot_be_compared(make_run: MakeRun, folder: Path) -> None:
    """No run, one that failed, and a summary of another run beside the signals, which is no verdict about them."""
    with (folder / "results.csv").open("a") as file:
        file.write("\n")
    with pytest.raises(ResultsError, match=r"results\.csv isn't of the run that summary\.json beside it describes"):
        flexfmu.compare(folder)
    with pytest.raises(InputError, match="nothing to compare"):
        flexfmu.compare()
    with pytest.raises(ResultsError, match="can't be compared, since its run failed: step failed"):
        flexfmu.compare(make_run(outcome=Outcome.STEP_FAILED, end=0.2))


SAMPLE = 1e-3


def signal(time: np.ndarray, number: int) -> np.ndarray:
    """A smooth motion that ends in a decaying vibration of 60 Hz, at rest before and after."""
    after = np.clip(time - 0.4, 0.0, None)
    pulse = np.exp(-(((time - 0.2) / 0.06) ** 2)) * np.sin(20.0 * time + number)
    return np.asarray(3.0 + 40.0 * pulse + 5.0 * np.exp(-20.0 * after) * np.sin(2.0 * np.pi * 60.0 * after))


def simulated(number: int = 0) -> TimedValues:
    """The signal as a simulation has it, with an instant that appears twice."""
    time = np.sort(np.append(np.linspace(0.0, 0.7, 3501), 0.4))
    return TimedValues(time, signal(time, number))


def measured(delay: float, noise: float = 0.0, seed: int = 0, number: int = 0, span: float = 1.0) -> TimedValues:
    """The signal at 1 kHz, later by a delay, with white noise."""
    time = 7.0 + np.arange(0.0, span, SAMPLE)
    random = np.random.default_rng([seed, number])
    return TimedValues(time, signal(time - delay, number) + noise * random.standard_normal(time.size))


@pytest.mark.parametrize("delay", [7.1, 7.0123456, 7.29999])
def test_a_known_delay_is_found_to_a_thousandth_of_a_sample(delay: float) -> None:
    """Without noise only the interpolation of the simulation is left."""
    found = estimate_delay([(measured(delay), simulated())])
    assert found.seconds == pytest.approx(delay, abs=1e-3 * SAMPLE)
    assert found.correlation == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_the_stated_error_is_that_of_noise(memory: float) -> None:
    """Over many draws of white and of coloured noise the error is as large as its standard error says, or a third larger."""
    delay, scaled, clean = 7.0123456, [], measured(7.0123456)
    for seed in range(100):
        shocks = np.sqrt(1.0 - memory**2) * np.random.default_rng(seed).standard_normal(clean.time.size)
        log = TimedValues(clean.time, clean.values + lfilter([1.0], [1.0, -memory], shocks))
        found = estimate_delay([(log, simulated())])
        assert 0.0 < found.error < 0.5 * SAMPLE
        scaled.append((found.seconds - delay) / found.error)
    # of 100 normally distributed numbers the root mean square is 1 ± 0.07
    assert 0.8 < np.sqrt(np.mean(np.square(scaled))) < 1.4


def test_several_signals_give_a_smaller_error() -> None:
    """All signals together, whatever their units."""
    pairs = [(measured(7.05, 1.0, 0, number), simulated(number)) for number in range(4)]
    milli = [(TimedValues(a.time, 1e3 * a.values), TimedValues(b.time, 1e3 * b.values)) for a, b in pairs[:2]]
    one, four = estimate_delay(pairs[:1]), estimate_delay([*milli, *pairs[2:]])
    assert four.error < 0.7 * one.error
    assert four.seconds == pytest.approx(7.05, abs=4.0 * four.error)


def test_an_offset_a_factor_and_a_short_or_long_log_do_no_harm() -> None:
    """The mean of a signal doesn't matter, nor that the log ends before the simulation, or lasts a minute in which the robot stands still
    but for one motion."""
    log = measured(7.02, span=0.5)
    changed = TimedValues(log.time, 1.2 * log.values - 50.0)
    assert estimate_delay([(changed, simulated())]).seconds == pytest.approx(7.02, abs=0.01 * SAMPLE)
    minute = estimate_delay([(measured(41.2345678, 0.5, span=60.0), simulated())])
    assert minute.seconds == pytest.approx(41.2345678, abs=0.3 * SAMPLE)


def test_differences_over_the_common_time() -> None:
    """RMS, mean and largest difference of a known one: an offset and a sine of whole periods."""
    time = np.linspace(-0.2, 1.2, 1401)
    log = TimedValues(time, signal(time, 0) + 0.5 + 0.2 * np.sin(2.0 * np.pi * 10.0 * time))
    found = difference(log, simulated(), 0.0)
    assert (found.time[0], found.time[-1]) == pytest.approx((0.0, 0.7))
    assert found.mean == pytest.approx(0.5, abs=1e-4)
    assert found.root_mean_square == pytest.approx(np.hypot(0.5, 0.2 / np.sqrt(2.0)), abs=1e-4)
    assert found.largest == pytest.approx(0.7, abs=1e-3)
    assert found.relative == pytest.approx(found.root_mean_square / np.ptp(found.measured))


def test_what_cannot_be_aligned() -> None:
    """Constant signals, and signals without a common time, are refused; the wrong sign shows in the correlation."""
    flat = TimedValues(np.linspace(0.0, 1.0, 100), np.ones(100))
    with pytest.raises(InputError, match="no signal changes in both"):
        estimate_delay([(flat, simulated())])
    with pytest.raises(InputError, match=r"overlap in 0 samples only: with a delay of 0 s .* from 7 to 7\.999 s"):
        difference(measured(7.0), simulated(), 0.0)
    log = measured(7.0)
    assert correlation([(TimedValues(log.time, -log.values), simulated())], 7.0) == pytest.approx(-1.0, abs=1e-4)


CHANGES = {
    "effects.proximal_bending": 1,
    "effects.distal_axial": 0,
    "effects.motor_inertia": 0.1,
    "trajectory.duration": 0.2,
    "trajectory.dwell": 0.02,
    "cosimulation.step": 1e-3,
    "cosimulation.tolerance": 1e-4,
    "cosimulation.drive": "torque",
}
PD = {"kind": "pd", "proportional": 5e3, "derivative": 100.0, "sample_time": 1e-3}
SCENE = flexfmu.load_scene("barnard2012-6kg").replace({**CHANGES, "name": "soft", "controller": [PD]})
STIFF = SCENE.replace({"name": "stiff", "pd.kp": 1e4})
WILD = SCENE.replace({"name": "wild", "pd.kd": 2e3})


@pytest.fixture(scope="module")
def found() -> Comparison:
    """Three controllers, one of which is unstable."""
    return flexfmu.compare(SCENE, STIFF, WILD, payload_band=0.2)


@pytest.mark.slow
def test_the_band_is_two_runs_of_the_robot_with_other_payloads(found: Comparison) -> None:
    """The worst of two runs with the payload error that the scene file has for it."""
    for scene, run in zip((SCENE, STIFF), found.runs, strict=False):
        assert run.band is not None
        assert run.band.masses == pytest.approx((4.8, 7.2))
        ends = [
            metrics_of(flexfmu.run(scene.replace({"imperfection": [{"kind": "payload-error", "relative": each}]})))
            for each in (-0.2, 0.2)
        ]
        for name, value in run.band.worst.items():
            values = [each[name] for each in ends]
            assert (value.value is None) == (None in values), name
            if value.value is not None:
                assert value == pytest.approx(max(each for each in values if each is not None), rel=1e-9), name
        expected = flexfmu.margins(scene, poses=2).worst
        assert run.loop["gain_margin"] == pytest.approx(expected.gain_margin, rel=1e-12)
        assert run.loop["cpu_time"] is not None
        assert 0.0 < run.loop["cpu_time"] < 60.0
    assert found.runs[0].band != found.runs[1].band


@pytest.mark.slow
def test_an_unstable_loop_has_a_message_and_the_others_their_figures(found: Comparison) -> None:
    """In the table, the page and the data; alone it is an error as ever."""
    soft, stiff, wild = found.runs
    assert "unstable" in wild.failure
    assert not wild.metrics
    assert (soft.failure, stiff.failure) == ("", "")
    page = found.page()
    assert "Worst with other payloads" in page
    assert "Gain margin [dB]" in page
    assert "Processor time of the simulation" in page
    assert wild.failure[:40] in page
    frame = found.to_pandas()
    assert frame.loc["worst.peak_torque_1", "soft"] == soft.band.worst["peak_torque_1"]  # type: ignore[union-attr]
    assert frame.attrs["units"]["cpu_time"] == "s"
    assert [bool(each.get("failure")) for each in found.as_data()["runs"]] == [False, False, True]
    with pytest.raises(ResultsError, match="wild can't be compared, since its run failed"):
        flexfmu.compare(WILD)


@pytest.mark.slow
def test_an_unstable_loop_that_reaches_its_end_has_metrics_and_a_message(found: Comparison) -> None:
    """Its oscillation is still small, its margins say that it grows."""
    beyond = 1.01 * (found.runs[0].loop["gain_margin"] or 0.0)
    nearly = SCENE.replace({"name": "nearly", "pd.kp": 5e3 * beyond, "pd.kd": 100.0 * beyond})
    (run,) = flexfmu.compare(nearly).runs
    assert run.metrics
    assert run.failure.startswith("the loop is unstable about the pose at")


@pytest.mark.slow
def test_the_command_names_and_varies_scenes(tmp_path: Path) -> None:
    """NAME=SCENE, --variant and --set; a variant that is unstable gives status 1 and a line."""
    settings = [f"--set={key}={value}" for key, value in CHANGES.items()]
    text = "controller=[{kind='pd',proportional=5e3,derivative=100.0,sample_time=1e-3}]"
    arguments = ["soft=barnard2012-6kg", *settings, "--set", text, "--variant", "wild:pd.kd=2e3,pd.kp=[5e3,5e3]"]
    result = command("compare", *arguments, "--json")
    assert result.exit_code == 1, result.output
    assert result.stderr.startswith("flexfmu: wild failed: joint")
    data = json.loads(result.stdout)["runs"]
    assert [each["name"] for each in data] == ["soft", "wild"]
    assert data[0]["metrics"]["peak_torque_1"] == pytest.approx(metrics_of(flexfmu.run(SCENE))["peak_torque_1"])


def test_bands_of_payloads() -> None:
    """Fractions are those of the robot's payload, with its error; masses are as given."""
    heavier = SCENE.replace({"imperfection": [{"kind": "payload-error", "relative": 0.5}]})
    assert band_masses(heavier, parse_band("0.1")) == pytest.approx((8.1, 9.9))
    assert band_masses(SCENE, parse_band("0,8")) == (0.0, 8.0)
    for band, message in (((8.0, 4.0), "lightest"), (0.0, "above 0"), (float("nan"), "above 0")):
        with pytest.raises(InputError, match=message):
            band_masses(SCENE, band)
    with pytest.raises(InputError, match="has no payload"):
        band_masses(SCENE.replace({"payload.mass": 0.0}), 0.2)
    with pytest.raises(SceneError, match="no scene file"):
        flexfmu.compare("nothing", payload_band=0.1)
