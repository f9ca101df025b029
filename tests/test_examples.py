"""The examples run as a user runs them: as scripts, from any folder, without a warning; and print and leave what they are for."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
PAPER = pytest.approx(73.634, rel=5e-3)
"""Peak torque of the paper's 6 kg scene [N m]."""

Check = Callable[[list[str], list[list[float]]], object]


def rising(values: object, axis: int = 0) -> bool:
    """Whether each value is above the one before."""
    return bool(np.all(np.diff(np.array(values), axis=axis) > 0.0))


def numbers(text: str) -> list[float]:
    """All numbers in a text that stand alone."""
    return [float(number) for number in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])", text)]


def planned(knots: int) -> Check:
    """A motion of a planner is faster than the scene's, with knots of the planner alone, simulated from the written table."""
    return lambda lines, n: (
        0.15 < n[0][0] < 0.25 and n[0][1] <= knots and 75.0 < n[1][0] < 300.0 and 1e-5 < n[2][0] < 1e-3
    )


EXPECTED: dict[str, Check] = {
    "run_scene.py": lambda lines, n: "reached its stop time" in lines[0] and lines[-1] == "wrote results.csv",
    # three motors for both joints; the smallest lacks peak torque, the two others fit
    "choose_motor.py": lambda lines, n: (
        [row.rpartition("  ")[2] for row in lines[1:]] == ["no: peak torque"] * 2 + ["yes"] * 4
    ),
    # the delay is found within a few standard errors; with the right payload the differences are the noise
    "compare_measured.py": lambda lines, n: (
        abs(n[0][0] - 12.3456) < 4.0 * n[0][1] < 0.2
        and all(0.09 < each < 0.11 for each in n[1][-2:])
        and min(n[2][-2:]) > 0.3
    ),
    # the deeper the notch, the more delay the loop stands
    "filter_notch.py": lambda lines, n: (
        rising([1.0, *(float(row.split()[-2]) for row in lines), 3.0]) and len(lines) == 3
    ),
    # stiffer loops follow better, the rigid torques better still; with other payloads each is worse
    "compare_controllers.py": lambda lines, n: (
        [row.split(",")[0] for row in lines[1:]] == ["pd", "stiff", "with-torques", "shaped"]
        and (error := np.array([row.split(",")[1:3] for row in lines[1:]], dtype=float))[0, 0] > error[1, 0]
        and rising(error[[3, 2, 0], 0])
        and rising(error, 1)
    ),
    # the tuned loop tracks better, within the limits; the folder has a scene that runs
    "tune_loop.py": lambda lines, n: (
        [row.partition(" = ")[0] for row in lines[:-1]] == ["pd.kp", "pd.kd"]
        and n[-1][0] < n[-1][1]
        and lines[-1].endswith("within limits: True")
    ),
    # standing still keeps the static torque; the paper's peak torque comes out of plain fmpy
    "fmpy_script.py": lambda lines, n: (
        len(set(re.findall(r"(-\d+\.\d+) N\.m", lines[0]))) == 1
        and (peaks := [float(re.findall(r"[\d.]+(?= N\.m)", line)[0]) for line in lines[1:]])[0] == PAPER
        and peaks[1] < 0.3 * peaks[0]
    ),
    # both designs have all metrics, and they differ
    "own_robot.py": lambda lines, n: (
        len(lines) == 8 and all("–" not in row and row.split()[-2] != row.split()[-4] for row in lines[1:])
    ),
    # torque and deviation grow with the payload; the last row is the paper's scene
    "payload_sweep.py": lambda lines, n: (
        (table := np.array(n[1:])).shape == (6, 4) and rising(table[:, :3]) and table[table[:, 0] == 6.0, 1] == PAPER
    ),
    # torque grows with the payload and falls with the duration
    "many_variants.py": lambda lines, n: (
        (table := np.array(n[1:])[:, 1:]).shape == (3, 5)
        and rising(table, 1)
        and rising(-table)
        and table[2, 3] == PAPER
    ),
    # the paper's bands of the first and third frequency; bending of the distal links puts modes below the third
    "frequencies.py": lambda lines, n: (
        (table := np.array([numbers(row.partition("%")[2]) for row in lines[1:-1]]))[:, 0].min() > 123.5
        and table[:, 0].max() < 128.5
        and 1904.0 < table[:, 2].min() <= table[:, 2].max() < 1920.5
        and n[-1][2] < 620.0
    ),
    # the largest speed of the arch of 0.2 m is twice its mean one: 2 * 0.2 m / 0.4 s, a little more aslant
    "own_trajectory.py": lambda lines, n: 20.0 < n[0][0] < 60.0 and 1.0 < n[1][0] < 1.05,
    # with the right payload the replayed torques are those of the log, with the wrong one they are a percent off
    "replay_log.py": lambda lines, n: max(n[0][-2:]) < 0.05 and min(n[1][-2:]) > 0.5,
    "ruckig_motion.py": planned(14),
    "toppra_motion.py": planned(200),
    # valid SSP with one FMU for each slave, which comes back as the scene
    "ssp_export.py": lambda lines, n: (
        lines[0].endswith("valid; trajectory, plant, pd, encoder")
        and n[1][0] < 1e-11
        and n[2] == pytest.approx([n[2][1]] * 2, abs=1e-7)
        and n[2][1] == pytest.approx(0.175, abs=1e-3)
    ),
    # the chosen set bends the distal links, every effect has its contribution, and the FMU the tolerance's other half
    "effects_auto.py": lambda lines, n: (
        lines[0].startswith("effects chosen for 2 %: proximal bending 2, distal bending 1")
        and sum(bool(re.match(r"  (?:in |out) \w+: .* %  +[+-]\d+$", row)) for row in lines) >= 8
        and "tolerance 0.001" in "".join(lines)
    ),
    # the planned scene leaves what the plan says for this payload
    "plan_own_robot.py": lambda lines, n: (
        0.0 < n[-1][0] < 1.01e6 * float(re.findall(r"residual: ([\d.e-]+) m", "".join(lines))[0])
    ),
}
"""Example → whether its lines, and the numbers that stand alone in each, are as they should be."""

LEFT = {
    "run_scene.py": "results.csv",
    "compare_measured.py": "comparison/comparison.html",
    "compare_controllers.py": "comparison/comparison.html",
    "tune_loop.py": "tuned/tuned.toml",
    "ruckig_motion.py": "ruckig.csv",
    "toppra_motion.py": "toppra.csv",
    "plan_own_robot.py": "planned-steel/plan.html",
}
"""Files that examples leave."""


def run_example(name: str, folder: Path) -> list[str]:
    """Lines of the standard output of an example that ran in ``folder``; warnings are errors."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, cwd=folder)
    assert (outcome.returncode, outcome.stderr) == (0, ""), outcome.stderr
    return outcome.stdout.splitlines()


def test_all_examples_are_tested() -> None:
    """An example that nobody runs would rot."""
    loops = Path(__file__).parent / "cosim" / "experiment" / "test_loop_examples.py"
    elsewhere = re.findall(r'"(\w+\.py)"', loops.read_text(encoding="utf-8"))
    assert {path.name for path in EXAMPLES.glob("*.py")} <= {*EXPECTED, *elsewhere}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
def test_example(name: str, tmp_path: Path) -> None:
    """It prints and leaves what its comment here says."""
    lines = run_example(name, tmp_path)
    assert EXPECTED[name](lines, [numbers(line) for line in lines]), lines
    assert name not in LEFT or (tmp_path / LEFT[name]).is_file()


@pytest.mark.slow
def test_results_in_other_tools(tmp_path: Path) -> None:
    """The Python of docs/results.md runs, and writes what it says; the number beside a metric is right."""
    text = (EXAMPLES.parent / "docs" / "results.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    shown = re.findall(r"peak_torque_1 +# ([\d.]+) N·m", code)[0]
    script = tmp_path / "results.py"
    script.write_text(f"{code}\nassert abs(run.metrics.peak_torque_1 - {shown}) < 1e-4\n", encoding="utf-8")
    lines = run_example(str(script), tmp_path)
    assert lines[0].startswith("Metrics of barnard2012-6kg, in SI units:")
    assert (tmp_path / "torques.png").is_file()
    assert (tmp_path / "run.mat").is_file()
