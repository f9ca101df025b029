"""Runs from memory, folders and files side by side, and a measurement of one of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from command_line import flexfmu as command

import flexfmu
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import file_digest
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.summary import summarise

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
    assert "Spectra of measured signals" in page
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
