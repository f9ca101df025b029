"""The examples run as a user runs them: as scripts, from any folder, without a warning; and print and leave what they are for."""

from __future__ import annotations

import csv
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


def value(line: str, what: str) -> float:
    """The number behind some words."""
    found = re.search(rf"{what} +(-?[\d.]+(?:e[-+]\d+)?)", line)
    assert found is not None, line
    return float(found.group(1))


def figures(what: str, holds: Callable[..., bool]) -> Check:
    """Every line has the figure, and the figures are as promised."""
    return lambda lines, n: holds(*(value(line, what) for line in lines))


def columns(line: str) -> list[float]:
    """All numbers that stand alone in a line and have a point."""
    return [float(number) for number in re.findall(r"(?<=\s)-?\d+\.\d+(?=\s|$)", line)]


def controlled(lines: list[str], n: object) -> bool:
    """The scene file's sections all take part: the feedforward, the imperfections and the shaper."""
    rows = {line[:24].strip(): columns(line[24:]) for line in lines}
    torque, tracking, _, residual = range(4)
    assert len(rows) == 4
    return (
        rows["without the feedforward"][tracking] > 10.0 * rows["complete"][tracking]
        and rows["without imperfections"][residual] < 0.1 * rows["complete"][residual]
        and rows["without the shaper"][torque] > rows["complete"][torque]
    )


def delayed(lines: list[str], n: object) -> bool:
    """The later the torque, the larger the error, until the loop is unstable; the run says so and goes on."""
    *rows, unknown, known = lines
    errors = [value(row, "tracking error") for row in rows if "tracking" in row]
    is_known = value(known, "tracking error") < 0.3 * value(unknown, "tracking error")
    return is_known and errors == sorted(errors) and "unstable" in rows[-1]


def planned(knots: int) -> Check:
    """A motion of a planner is faster than the scene's, with knots of the planner alone, simulated from the written table."""
    return lambda lines, n: (
        0.15 < n[0][0] < 0.25 and n[0][1] <= knots and 75.0 < n[1][0] < 300.0 and 1e-5 < n[2][0] < 1e-3
    )


EXPECTED: dict[str, Check] = {
    # the limit cycle's amplitude is near 2; without rounding 0.5 +- sqrt(3)/2 i
    "own_van_der_pol.py": lambda lines, n: (
        all(value(row, "amplitude") == pytest.approx(2.01, abs=0.02) for row in lines[:3])
        and "0.500+0.866j, 0.500-0.866j" in lines[3]
    ),
    # nothing is lost; the concentration at 1e10 s follows 1 / t
    "own_robertson.py": lambda lines, n: (
        max(abs(value(row, "sum - 1")) for row in lines) < 1e-9
        and value(lines[-1], "a") == pytest.approx(2.083e-7, rel=5e-3)
    ),
    "own_cart_pole.py": lambda lines, n: (
        abs(value(lines[0], "end")) > 0.1 > 30.0 * abs(value(lines[1], "end")) and value(lines[1], "at most") < 1.0
    ),
    # the softer, the more it bends; all come to the same place
    "own_flexible_arm.py": lambda lines, n: (
        rising([-value(row, "bends by") for row in lines]) and len({row.partition("tip")[2] for row in lines}) == 1
    ),
    "own_slider_crank.py": figures("drifts by", lambda *drifts: max(drifts) < 1e-8),
    "own_ivp_slider_crank.py": figures("difference", lambda *found: len(found) == 10 and max(found) < 3e-8),
    # the rod at rest is a fin
    "own_heat_rod.py": lambda lines, n: columns(lines[-2]) == pytest.approx(columns(lines[-1]), abs=0.05),
    # the last bounce of which the ball rises faster than 0.05 m/s is the 20th; the next one ends its motion
    "own_bouncing_ball.py": lambda lines, n: (
        lines[0].startswith("21 bounces until 4.022") and value(lines[0], "within") < 1e-7
    ),
    "own_belt_drive.py": lambda lines, n: (
        10.0 < value(lines[0], "joint 1") < 40.0 and value(lines[1], "within") < 1e-12
    ),
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
    # two modes beside that of gravity, and margins within four standard errors of the model's
    "frequency_response.py": lambda lines, n: (
        "100 from 4 to 400 Hz" in lines[0]
        and [round(value(line, "mode at")) for line in lines[2:4]] == [140, 147]
        and all(abs(each[0] - each[2]) < 4.0 * each[1] < 0.05 * each[0] for each in n[-4:])
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
    # base half-distance and damping of the shipped scene, from one table alone
    "identify_paper.py": lambda lines, n: abs(n[0][0] / 0.1 - 1.0) < 5e-3 and abs(n[1][0] / 0.1357 - 1.0) < 0.02,
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
        0.0 < n[-1][0] < 1.01 * float(re.findall(r"residual: ([\d.e-]+) µm", "".join(lines))[0])
        and "all limits are kept" in "".join(lines)
    ),
    # the rigid torques of the motion take most of the error away
    "controller_pd.py": figures("tracking error", lambda alone, helped: helped < 0.1 * alone),
    # without feedforward the angle lags by the velocity over the gain, 8.7 rad/s over 60 1/s; each feedforward takes most of the rest
    "controller_cascade.py": figures(
        "tracking error", lambda alone, speed, torque: torque < 0.5 * speed < 0.5 * 0.2 * alone
    ),
    # faster sampling helps where the model is right, hardly where the payload is wrong
    "controller_computed_torque.py": figures(
        "error",
        lambda slow, slow_wrong, fast, fast_wrong: (
            fast < 0.8 * slow < 0.2 * slow_wrong and fast_wrong == pytest.approx(slow_wrong, rel=0.1)
        ),
    ),
    # every cycle is better than the one before; after eight of them a tenth of the error is left
    "controller_learning.py": figures(
        "tracking error", lambda *errors: [*errors] == sorted(errors, reverse=True) and errors[-1] < 0.1 * errors[0]
    ),
    # constant gains have the same margin everywhere; scheduled ones a smaller one where gains are larger
    "controller_gain_schedule.py": figures(
        "gain margin", lambda *found: max(found[:3]) < 1.05 * min(found[:3]) and found[3] < found[4] < found[5]
    ),
    # friction is a good part of a slow motion's error; half a compensation takes half of it
    "controller_friction.py": figures(
        "tracking error",
        lambda without, reference, measured, half: (
            max(reference, measured) < half < without and reference < 0.6 * without
        ),
    ),
    # each better model of the robot leaves the PD less
    "controller_flexible.py": figures(
        "tracking error", lambda none, rigid, flexible: flexible < 0.2 * rigid < 0.04 * none
    ),
    # more bandwidth costs robustness
    "controller_h_infinity.py": figures("disk margin", lambda _, slow, fast: fast < slow < 1.0),
    # a disturbed robot goes astray, more with a force than with noise; dropping the payload lifts it by a force of 58.9 N
    "disturbances.py": figures("tracking error", lambda quiet, push, noise, dropped: quiet < noise < push < dropped),
    # small errors of the angle do little; a rate from differences costs more than all of them
    "imperfection_sensor.py": figures(
        "tracking error",
        lambda ideal, *others: (
            all(each == pytest.approx(ideal, rel=0.2) for each in others[:-1]) and others[-1] > 2.0 * ideal
        ),
    ),
    # an own class gives the same numbers from Python and from the scene file
    "custom_controller.py": figures(
        "tracking error", lambda python, file: python == file == pytest.approx(7.9, rel=0.01)
    ),
    # a python-control system with foreign names controls the robot
    "custom_transfer_function.py": figures("tracking error", lambda error: error < 10.0),
    # the function in C and its FMU give the same error to the last digit
    "controller_c_function.py": figures("tracking error", lambda here, fmu: here == fmu < 10.0),
    # both rules against windup keep a robot at its limits on its way; without them it goes astray
    "controller_pid.py": lambda lines, n: (
        value(lines[0], "residual") > 100.0 and ["settled after" in row for row in lines[1:]] == [True, True]
    ),
    # feedforwards with a wrong payload leave an error, which the observer takes away
    "controller_disturbance_observer.py": lambda lines, n: (
        rising([-value(row, "largest error") for row in lines])
        and (left := [value(row, "left at the end") for row in lines])[0] > left[1] > 0.1
        and left[3] < 1e-4
    ),
    # the design is stable and the robot arrives within a micro-radian, observing its links from the motor angles
    "controller_lqg.py": lambda lines, n: (
        value(lines[0], "slowest pole") < -50.0 and value(lines[1], "at the end") < 1e-2
    ),
    # the exported controller moves the robot as its Python twin does
    "controller_fmu.py": lambda lines, n: value(lines[1], "joint angles:") < 1e-12,
    "controller_scene.py": controlled,
    # on joints and sampled it cancels the vibration and leaves the path; along the path it doesn't leave it
    "shaper_three_ways.py": lambda lines, n: (
        (residual := [value(row, "residual") for row in lines[1:]])[1] < 0.1 * residual[0]
        and residual[3] == pytest.approx(residual[1], rel=0.05)
        and abs(value(lines[3], "path by")) < 1e-4
        and value(lines[2], "path by") > 0.1
    ),
    # shapers take vibration away and need less torque, with a perfect drive most of all
    "shaper_controlled.py": lambda lines, n: (
        (table := np.array([columns(row) for row in lines[1:]]))[2, 1] < 0.2 * table[0, 1]
        and table[2:, 2].max() < table[:2, 2].min()
    ),
    # a motor that can't do what it is told follows worse than an ideal one
    "imperfection_actuator.py": lambda lines, n: (
        value(lines[1], "peak torque") == 80.0
        and (error := [value(row, "tracking error") for row in lines])[0] < min(error[1:])
        and len(error) == 5
    ),
    "imperfection_delay.py": delayed,
    # a low-pass of the velocity costs delay margin; a setpoint filter doesn't, and makes the robot late
    "filter_kinds.py": lambda lines, n: (
        (margin := [value(row, "delay margin") for row in lines])[1] < 0.8 * margin[0] == 0.8 * margin[3]
        and value(lines[3], "tracking error") > 20.0 * value(lines[0], "tracking error")
    ),
    # the error is smallest where the controller is right about the payload, and grows to both sides
    "imperfection_payload.py": lambda lines, n: (
        (error := [float(row.split()[4]) for row in lines])[2] == min(error)
        and error[0] > error[1]
        and error[-1] > error[-2]
    ),
    # trajectory, robot and controller are FMUs, and the torques lead from one to the other
    "export_slaves.py": lambda lines, n: "pd.joint1.torque -> plant.joint1.torque" in lines,
    # the function controls the robot as it stands and from a scene file, and leaves as an FMU
    "custom_function.py": lambda lines, n: (
        value(lines[0], "tracking error") < 10.0
        and value(lines[1], "tracking error") < 20.0
        and lines[2].startswith("exported: own_pid.fmu, PID control")
    ),
}
"""Example → whether its lines, and the numbers that stand alone in each, are as they should be."""

LEFT = {
    "controller_fmu.py": "fmus/pd.fmu",
    "own_belt_drive.py": "drive.fmu driven.ssp",
    "custom_function.py": "fmus/own_pid.fmu",
    "export_slaves.py": "fmus/trajectory.fmu fmus/plant.fmu fmus/pd.fmu",
    "run_scene.py": "results.csv",
    "compare_measured.py": "comparison/comparison.html",
    "identify_paper.py": "table7.csv",
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
    assert {path.name for path in EXAMPLES.glob("*.py")} == {*EXPECTED}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
def test_example(name: str, tmp_path: Path) -> None:
    """It prints and leaves what its comment here says."""
    lines = run_example(name, tmp_path)
    assert EXPECTED[name](lines, [numbers(line) for line in lines]), lines
    assert all((tmp_path / left).is_file() for left in LEFT.get(name, "").split())


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


@pytest.mark.slow
def test_the_table_of_shapers_in_the_loop(tmp_path: Path) -> None:
    """Every combination is there, with the residual vibrations of docs/shapers.md to their last digit but for rounding; a shaper takes
    vibration away with every drive, and a controller rests off the end pose where the payload is wrong."""
    script = EXAMPLES.parent / "benchmarks" / "shapers_in_the_loop.py"
    options = ["--out", str(tmp_path), "--errors", "3", "--only", "unshaped", "zvd"]
    subprocess.run([sys.executable, str(script), *options], capture_output=True, check=True, timeout=600)
    with (tmp_path / "shapers_in_the_loop.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 2 * 3
    assert "| zvd | 17.0 |" in (tmp_path / "shapers_in_the_loop.md").read_text(encoding="utf-8")
    page = (EXAMPLES.parent / "docs" / "shapers.md").read_text(encoding="utf-8")
    found = {(row["drive"], round(float(row["payload_error"]), 6), row["shaper"]): row for row in rows}
    for (drive, error, shaper), row in found.items():
        figure, unshaped = (
            {key: float(each[key]) for key in ("residual_vibration", "peak_torque")}
            for each in (row, found[drive, error, "unshaped"])
        )
        assert shaper == "unshaped" or all(figure[key] < unshaped[key] for key in figure)
        assert drive == "perfect drive" or shaper == "unshaped" or (float(row["rest_offset"]) > 1e-4) == (error != 0.0)
        table = page.split(f"### Residual vibration [µm], {drive}, by payload error")[1].split("\n##")[0]
        line = next(line for line in table.splitlines() if line.startswith(f"| {shaper} |"))
        shown = float(line.split("|")[{-0.3: 3, 0.0: 6, 0.3: 9}[error]])
        assert shown == pytest.approx(1e6 * figure["residual_vibration"], abs=0.06)
