"""What `flexfmu paper` writes when something goes wrong on the way."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.studies.paper import command
from flexfmu.cosim.studies.paper.computed import PaperCase, PaperError, SimulatedCase, simulation_evaluators

CASES: tuple[PaperCase, ...] = (
    ("barnard2012-6kg", "Bang-bang", "Lamé"),
    ("barnard2012-6kg", "Bang-bang", "Clothoid"),
    ("barnard2012-6kg", "Bang-bang", "Polar"),
)


def simulation(case: PaperCase) -> SimulatedCase:
    """A simulation whose metrics are 1, 2, 3, ... in the order of `METRICS`."""
    metrics = {name: float(index) for index, name in enumerate(METRICS, 1)}
    return SimulatedCase(case, metrics, 0.43, np.array([0.0, 0.68]), np.array([0.0, 1e-4]), Path("plant.fmu"), 0.2)


def fail_after_two(cases: Iterable[PaperCase]) -> Iterator[SimulatedCase]:
    done = [simulation(case) for case in cases]
    yield from done[:2]
    raise PaperError("the FMU gave up at 0.1 s")


def test_simulations_before_a_failure_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interruption after two of three simulations leaves two lines of metrics."""
    monkeypatch.setattr(command, "simulate", fail_after_two)
    with pytest.raises(PaperError, match="gave up"):
        command.simulate_cases(CASES, tmp_path, lambda what, fraction: None)
    lines = list(csv.DictReader((tmp_path / "simulations.csv").read_text(encoding="utf-8").splitlines()))
    assert [(line["scene"], line["profile"], line["curve"]) for line in lines] == list(CASES[:2])
    assert float(lines[0]["peak_torque_1"]) == 1.0


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    """Nobody waits for simulations whose results have nowhere to go."""
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="can't write"):
        command.run_paper(tmp_path / "file" / "results")


def test_progress_never_goes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar that the user sees grows from 0 to 1."""
    monkeypatch.setattr(command, "simulate", lambda cases: map(simulation, cases))
    seen: list[float] = []
    command.simulate_cases(CASES, tmp_path, lambda what, fraction: seen.append(fraction))
    assert seen == sorted(seen)
    assert 0.0 <= seen[0] <= seen[-1] <= 1.0


def test_both_names_of_the_clothoid_pair_are_one_simulation() -> None:
    """Tables 7 and 11 name the same curve differently."""
    done = {case: simulation(case) for case in CASES}
    torque = simulation_evaluators(done, "barnard2012-6kg")["peak_torque_1"]
    assert torque("Bang-bang", "Clot.") == torque("Bang-bang", "Clothoid") == 1.0


def test_a_metric_without_a_value_is_an_error() -> None:
    """A run that was cut short must not become an empty cell."""
    case = CASES[0]
    broken = SimulatedCase(case, dict.fromkeys(METRICS), 0.43, np.zeros(1), np.zeros(1), Path("plant.fmu"), 0.0)
    with pytest.raises(PaperError, match="Bang-bang, Lamé: the simulation has no peak_torque_1"):
        simulation_evaluators({case: broken}, case[0])["peak_torque_1"]("Bang-bang", "Lamé")
