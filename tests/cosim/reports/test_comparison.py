"""The page that compares runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.reports.chart import unpacked
from flexfmu.cosim.reports.comparison import ComparedRun, metrics_table, render_comparison
from flexfmu.cosim.reports.page import Table
from flexfmu.cosim.studies.compare.comparison import compare_runs

TIME = np.linspace(0.0, 0.6, 3001)


def compared(name: str, amplitude: float, count: int = 1) -> ComparedRun:
    """A run that rings at 50 Hz."""
    ringing = amplitude * np.sin(2.0 * np.pi * 50.0 * TIME)
    columns = {f"end_effector.position.{axis}": Column("m", 0.2 + 1e-5 * ringing) for axis in "xy"}
    columns["joint1.torque"] = Column("N.m", 10.0 * ringing)
    metrics = {"peak_torque_1": Metric(10.0 * amplitude), "settling_time": Metric(None)}
    return ComparedRun(name, Recording(TIME, columns), metrics, 0.3)


def test_metrics_stand_beside_each_other_with_differences() -> None:
    """Relative to the first run; no value is a dash."""
    table = metrics_table([compared("slow", 1.0), compared("fast", 1.25), ComparedRun("measured", Recording(TIME, {}))])
    assert table.header == ["Metric", "Name", "slow", "fast", "measured"]
    assert table.rows[0] == ["Peak torque, joint 1", "peak_torque_1", "10 N·m", "12.5 N·m (+25 %)", "–"]
    assert table.rows[1][2:] == ["–", "–", "–"]


def test_curves_are_the_recordings() -> None:
    """The values that the page shows are recorded ones, to the 24 bits that it keeps."""
    runs = [compared("slow", 1.0), compared("<fast>", 1.25)]
    text = render_comparison(runs, [metrics_table(runs), Table("More", ["", "a"], [["b", "7 %"]])])
    found = dict(re.findall(r'data-xy="([^"]*)" data-label="([^"]*)"', text)[i][::-1] for i in (0, 1))
    assert set(found) == {"slow", "&lt;fast&gt;"}
    for name, amplitude in (("slow", 1.0), ("&lt;fast&gt;", 1.25)):
        x, y = unpacked(found[name], 2)
        np.testing.assert_allclose(y, 10.0 * amplitude * np.sin(2.0 * np.pi * 50.0 * x), atol=1e-3)
        assert np.isin(x.astype(np.float32), TIME.astype(np.float32)).all()
        assert y.max() == pytest.approx(10.0 * amplitude, rel=1e-6)
    assert "<fast>" not in text
    assert "7 %" in text
    assert text.count("50 Hz") == 2


def test_many_runs_stay_below_the_limit_of_a_page() -> None:
    """Of 1.5 MB; each run has fewer points then."""
    text = compare_runs([compared(f"run {i}", 1.0 + i) for i in range(30)]).page()
    assert len(text.encode()) < 1.5e6


@pytest.mark.slow
def test_the_documented_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """docs/results.md: a page of two runs."""
    text = (Path(__file__).parents[3] / "docs" / "results.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```", text.partition("\n### Compare runs")[2], re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "docs/results.md", "exec"), {})
    page = (tmp_path / "comparison" / "comparison.html").read_text(encoding="utf-8")
    assert "Spectra of the residual vibration" in page
    assert re.search(r"\(−\d+\.\d %\)", page)
