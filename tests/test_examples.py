"""The examples run as a user runs them: as scripts, from any folder, without a warning."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv

EXAMPLES = Path(__file__).parents[1] / "examples"


def run_example(name: str, folder: Path) -> str:
    """Standard output of an example that ran in ``folder``; warnings are errors."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, cwd=folder)
    assert (outcome.returncode, outcome.stderr) == (0, ""), outcome.stderr
    return outcome.stdout


def numbers(text: str) -> list[float]:
    """All numbers in a text that stand alone."""
    return [float(number) for number in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])", text)]


def test_all_examples_are_tested() -> None:
    """An example that nobody runs would rot."""
    here = Path(__file__)
    loops = here.parent / "cosim" / "experiment" / "test_loop_examples.py"
    tested = "".join(path.read_text(encoding="utf-8") for path in (here, loops))
    assert all(f'"{path.name}"' in tested for path in EXAMPLES.glob("*.py"))


@pytest.mark.slow
def test_run_scene(tmp_path: Path) -> None:
    """The script prints the metrics and the jump of an acceleration, and leaves a file that fmpy reads."""
    output = run_example("run_scene.py", tmp_path)
    assert "the simulation reached its stop time" in output
    torque = re.search(r"peak_torque_1 +([\d.]+) N·m", output)
    assert torque is not None
    assert 35.0 < float(torque.group(1)) < 45.0
    results = read_csv(tmp_path / "results.csv")
    assert abs(results["joint1.torque"]).max() == pytest.approx(float(torque.group(1)), rel=1e-3)


@pytest.mark.slow
def test_choose_motor(tmp_path: Path) -> None:
    """Three motors for both joints; the smallest lacks peak torque, the two others fit."""
    rows = run_example("choose_motor.py", tmp_path).splitlines()[1:]
    assert [row.rpartition("  ")[2] for row in rows] == ["no: peak torque"] * 2 + ["yes"] * 4


@pytest.mark.slow
def test_compare_measured(tmp_path: Path) -> None:
    """The delay is found within a few standard errors; with the right payload the differences are the noise."""
    late, right, wrong = run_example("compare_measured.py", tmp_path).splitlines()
    delay, error = numbers(late)
    assert delay == pytest.approx(12.3456, abs=4.0 * error)
    assert error < 0.05
    assert all(each == pytest.approx(0.1, rel=0.1) for each in numbers(right)[-2:])
    assert min(numbers(wrong)[-2:]) > 0.3
    assert (tmp_path / "comparison" / "comparison.html").is_file()


@pytest.mark.slow
def test_filter_notch(tmp_path: Path) -> None:
    """The deeper the notch, the more delay the loop stands."""
    delays = [float(line.split()[-2]) for line in run_example("filter_notch.py", tmp_path).splitlines()]
    assert len(delays) == 3
    assert 1.0 < delays[0] < delays[1] < delays[2] < 3.0


@pytest.mark.slow
def test_compare_controllers(tmp_path: Path) -> None:
    """Stiffer loops follow better, the rigid torques better still; with other payloads each is worse."""
    rows = [row.split(",") for row in run_example("compare_controllers.py", tmp_path).splitlines()[1:]]
    assert [row[0] for row in rows] == ["pd", "stiff", "with-torques", "shaped"]
    tracking, worst, _, _ = zip(*([float(each) for each in row[1:]] for row in rows), strict=True)
    assert tracking[0] > tracking[1]
    assert tracking[0] > tracking[2] > tracking[3]
    assert all(more > less for more, less in zip(worst, tracking, strict=True))
    assert (tmp_path / "comparison" / "comparison.html").is_file()


@pytest.mark.slow
def test_tune_loop(tmp_path: Path) -> None:
    """The tuned loop tracks better, within the limits; the folder has a scene that runs."""
    *gains, errors = run_example("tune_loop.py", tmp_path).splitlines()
    assert [each.partition(" = ")[0] for each in gains] == ["pd.kp", "pd.kd"]
    tuned, given = numbers(errors)
    assert tuned < given
    assert errors.endswith("within limits: True")
    assert 'name = "loop"' in (tmp_path / "tuned" / "tuned.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_results_in_other_tools(tmp_path: Path) -> None:
    """The Python of docs/results.md runs, and writes what it says; the number beside a metric is right."""
    text = (EXAMPLES.parent / "docs" / "results.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    shown = re.search(r"peak_torque_1 +# ([\d.]+) N·m", code)
    assert shown is not None
    script = tmp_path / "results.py"
    script.write_text(f"{code}\nassert abs(run.metrics.peak_torque_1 - {shown[1]}) < 1e-4\n", encoding="utf-8")
    assert run_example(str(script), tmp_path).startswith("Metrics of barnard2012-6kg, in SI units:\n  peak_torque_1")
    assert (tmp_path / "torques.png").is_file()
    assert (tmp_path / "run.mat").is_file()


@pytest.mark.slow
def test_fmpy_script(tmp_path: Path) -> None:
    """Standing still keeps the static torque; the paper's peak torque comes out of plain fmpy within half a percent."""
    still, *moving = run_example("fmpy_script.py", tmp_path).splitlines()
    before, after = re.findall(r"(-\d+\.\d+) N\.m", still)
    assert before == after
    peaks = [float(re.findall(r"[\d.]+(?= N\.m)", line)[0]) for line in moving]
    assert peaks[0] == pytest.approx(73.634, rel=5e-3)
    assert peaks[1] < 0.3 * peaks[0]


@pytest.mark.slow
def test_own_robot(tmp_path: Path) -> None:
    """Both designs have all metrics, and they differ."""
    table = run_example("own_robot.py", tmp_path).splitlines()[1:]
    assert len(table) == 7
    assert all("–" not in row and row.split()[-2] != row.split()[-4] for row in table)


@pytest.mark.slow
def test_payload_sweep(tmp_path: Path) -> None:
    """Torque and deviation grow with the payload; the 6 kg row is the paper's scene."""
    rows = np.array([numbers(line) for line in run_example("payload_sweep.py", tmp_path).splitlines()[1:]])
    assert rows.shape == (6, 4)
    assert np.all(np.diff(rows[:, :3], axis=0) > 0.0)
    assert rows[rows[:, 0] == 6.0, 1] == pytest.approx(73.634, rel=5e-3)


@pytest.mark.slow
def test_many_variants(tmp_path: Path) -> None:
    """Torque grows with the payload and falls with the duration; 6 kg in 0.43 s are the paper's scene."""
    rows = np.array([numbers(line) for line in run_example("many_variants.py", tmp_path).splitlines()[1:]])
    assert rows.shape == (3, 6)
    assert np.all(np.diff(rows[:, 1:], axis=1) > 0.0)
    assert np.all(np.diff(rows[:, 1:], axis=0) < 0.0)
    assert rows[2, 4] == pytest.approx(73.634, rel=5e-3)


@pytest.mark.slow
def test_frequencies(tmp_path: Path) -> None:
    """The paper's bands of the first and third frequency; bending of the distal links puts modes below the third."""
    _, *poses, last = run_example("frequencies.py", tmp_path).splitlines()
    table = np.array([numbers(line.partition("%")[2]) for line in poses])
    assert np.all((table[:, 0] > 123.5) & (table[:, 0] < 128.5))
    assert np.all((table[:, 2] > 1904.0) & (table[:, 2] < 1920.5))
    assert numbers(last)[2] < 620.0


@pytest.mark.slow
def test_own_trajectory(tmp_path: Path) -> None:
    """The robot makes the arch of 0.2 m, whose largest speed is twice its mean one: 2 * 0.2 m / 0.4 s, a little more aslant."""
    torque, speed = run_example("own_trajectory.py", tmp_path).splitlines()
    assert 20.0 < numbers(torque)[0] < 60.0
    assert 1.0 < numbers(speed)[0] < 1.05


@pytest.mark.slow
def test_replay_log(tmp_path: Path) -> None:
    """With the right payload the replayed torques are those of the log, with the wrong one they are a percent off."""
    right, wrong = run_example("replay_log.py", tmp_path).splitlines()
    assert max(numbers(right)[-2:]) < 0.05
    assert min(numbers(wrong)[-2:]) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("library", ["ruckig", "toppra"])
def test_motions_of_planners(tmp_path: Path, library: str) -> None:
    """Faster than the scene's motion, with knots of the planner alone, and simulated from the written table."""
    motion, torque, residual = run_example(
        {"ruckig": "ruckig_motion.py", "toppra": "toppra_motion.py"}[library], tmp_path
    ).splitlines()
    duration, breakpoints = numbers(motion)
    assert 0.15 < duration < 0.25
    assert breakpoints <= {"ruckig": 14, "toppra": 200}[library]
    assert 75.0 < numbers(torque)[0] < 300.0
    assert 1e-5 < numbers(residual)[0] < 1e-3
    assert (tmp_path / f"{library}.csv").read_text().startswith("time,q11,q21,dq11")


@pytest.mark.slow
def test_ssp_export(tmp_path: Path) -> None:
    """The file is valid SSP 1.0 with one FMU for each slave, and comes back as the scene."""
    written, difference, ends = run_example("ssp_export.py", tmp_path).splitlines()
    assert written.endswith("valid; trajectory, plant, pd, encoder")
    assert numbers(difference)[0] < 1e-11
    coarse, exported = numbers(ends)
    assert coarse == pytest.approx(exported, abs=1e-7)
    assert exported == pytest.approx(0.175, abs=1e-3)


@pytest.mark.slow
def test_effects_auto(tmp_path: Path) -> None:
    """The chosen set bends the distal links, every effect has its contribution, and the FMU has the tolerance's other half."""
    output = run_example("effects_auto.py", tmp_path)
    assert output.startswith("effects chosen for 2 %: proximal bending 2, distal bending 1")
    assert len(re.findall(r"^  (?:in |out) \w+: .* %  +[+-]\d+$", output, re.MULTILINE)) >= 8
    assert "tolerance 0.001" in output


@pytest.mark.slow
def test_plan_own_robot(tmp_path: Path) -> None:
    """The plan prints its limits and what the planned scene leaves, which is what the plan says for this payload."""
    output = run_example("plan_own_robot.py", tmp_path)
    *_, last = output.splitlines()
    assert "PlanResult of steel" in output
    planned = re.search(r"residual: ([\d.e-]+) m", output)
    assert planned is not None
    assert 0.0 < numbers(last)[0] < 1e6 * float(planned.group(1)) * 1.01
    assert (tmp_path / "planned-steel" / "plan.html").is_file()
