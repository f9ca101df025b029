"""The examples with controllers, shapers and imperfections run as a user runs them, and say what they promise."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "examples"

pytestmark = pytest.mark.slow


def lines(name: str, folder: Path) -> list[str]:
    """What an example prints when it runs in ``folder``; warnings are errors."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, cwd=folder)
    assert (outcome.returncode, outcome.stderr) == (0, ""), outcome.stderr
    return outcome.stdout.splitlines()


def value(line: str, what: str) -> float:
    """The number behind some words."""
    found = re.search(rf"{what} +(-?[\d.]+(?:e[-+]\d+)?)", line)
    assert found is not None, line
    return float(found.group(1))


def columns(line: str) -> list[float]:
    """All numbers that stand alone in a line."""
    return [float(number) for number in re.findall(r"(?<=\s)-?\d+\.\d+(?=\s|$)", line)]


PROMISES: dict[str, tuple[str, Callable[..., bool]]] = {
    # the rigid torques of the motion take most of the error away
    "controller_pd.py": ("tracking error", lambda alone, helped: helped < 0.1 * alone),
    # without feedforward the angle lags by the velocity over the gain, 8.7 rad/s over 60 1/s; each feedforward takes most of the rest
    "controller_cascade.py": ("tracking error", lambda alone, speed, torque: torque < 0.5 * speed < 0.5 * 0.2 * alone),
    # faster sampling helps where the model is right, hardly where the payload is wrong
    "controller_computed_torque.py": (
        "error",
        lambda slow, slow_wrong, fast, fast_wrong: (
            fast < 0.8 * slow < 0.2 * slow_wrong and fast_wrong == pytest.approx(slow_wrong, rel=0.1)
        ),
    ),
    # every cycle is better than the one before; after eight of them a tenth of the error is left
    "controller_learning.py": (
        "tracking error",
        lambda *errors: [*errors] == sorted(errors, reverse=True) and errors[-1] < 0.1 * errors[0],
    ),
    # constant gains have the same margin everywhere; scheduled ones a smaller one where gains are larger
    "controller_gain_schedule.py": (
        "gain margin",
        lambda *found: max(found[:3]) < 1.05 * min(found[:3]) and found[3] < found[4] < found[5],
    ),
    # friction is a good part of a slow motion's error; half a compensation takes half of it
    "controller_friction.py": (
        "tracking error",
        lambda without, reference, measured, half: (
            max(reference, measured) < half < without and reference < 0.6 * without
        ),
    ),
    # each better model of the robot leaves the PD less
    "controller_flexible.py": ("tracking error", lambda none, rigid, flexible: flexible < 0.2 * rigid < 0.04 * none),
    # more bandwidth costs robustness
    "controller_h_infinity.py": ("disk margin", lambda _, slow, fast: fast < slow < 1.0),
    # a disturbed robot goes astray, more with a force than with noise; dropping the payload lifts it by a force of 58.9 N
    "disturbances.py": ("tracking error", lambda quiet, push, noise, dropped: quiet < noise < push < dropped),
    # small errors of the angle do little; a rate from differences costs more than all of them
    "imperfection_sensor.py": (
        "tracking error",
        lambda ideal, *others: (
            all(each == pytest.approx(ideal, rel=0.2) for each in others[:-1]) and others[-1] > 2.0 * ideal
        ),
    ),
    # an own class gives the same numbers from Python and from the scene file
    "custom_controller.py": ("tracking error", lambda python, file: python == file == pytest.approx(7.9, rel=0.01)),
    # a python-control system with foreign names controls the robot
    "custom_transfer_function.py": ("tracking error", lambda error: error < 10.0),
    # the function in C and its FMU give the same error to the last digit
    "controller_c_function.py": ("tracking error", lambda here, fmu: here == fmu < 10.0),
}
"""Example → the figure in each of its lines, and what it promises of these."""


@pytest.mark.parametrize("name", PROMISES)
def test_promises(name: str, tmp_path: Path) -> None:
    """Every line has the figure, and the figures are as promised."""
    what, holds = PROMISES[name]
    found = [value(line, what) for line in lines(name, tmp_path)]
    assert holds(*found), found


def test_controller_pid(tmp_path: Path) -> None:
    """Both rules against windup keep a robot at its limits on its way; without them it goes astray."""
    unprotected, clamped, calculated = lines("controller_pid.py", tmp_path)
    assert value(unprotected, "residual") > 100.0
    assert "settled after" in clamped
    assert "settled after" in calculated


def test_controller_disturbance_observer(tmp_path: Path) -> None:
    """Feedforwards with a wrong payload leave an error, which the observer takes away."""
    rows = lines("controller_disturbance_observer.py", tmp_path)
    largest, left = ([value(row, what) for row in rows] for what in ("largest error", "left at the end"))
    assert largest == sorted(largest, reverse=True)
    assert left[0] > left[1] > 0.1
    assert left[3] < 1e-4


def test_controller_lqg(tmp_path: Path) -> None:
    """The design is stable and the robot arrives within a micro-radian, observing its links from the motor angles."""
    design, result = lines("controller_lqg.py", tmp_path)
    assert value(design, "slowest pole") < -50.0
    assert value(result, "at the end") < 1e-2


def test_controller_fmu(tmp_path: Path) -> None:
    """The exported controller moves the robot as its Python twin does."""
    _, result = lines("controller_fmu.py", tmp_path)
    assert value(result, "joint angles:") < 1e-12
    assert (tmp_path / "fmus" / "pd.fmu").is_file()


def test_controller_scene(tmp_path: Path) -> None:
    """The scene file's sections all take part."""
    rows = {line[:24].strip(): columns(line[24:]) for line in lines("controller_scene.py", tmp_path)}
    torque, tracking, _, residual = range(4)
    assert len(rows) == 4
    assert rows["without the feedforward"][tracking] > 10.0 * rows["complete"][tracking]
    assert rows["without imperfections"][residual] < 0.1 * rows["complete"][residual]
    assert rows["without the shaper"][torque] > rows["complete"][torque]


def test_shaper_three_ways(tmp_path: Path) -> None:
    """On joints and sampled it cancels the vibration and leaves the path; along the path it doesn't leave it."""
    _, *rows = lines("shaper_three_ways.py", tmp_path)
    unshaped, joints, path, sampled = rows
    assert value(joints, "residual") < 0.1 * value(unshaped, "residual")
    assert value(sampled, "residual") == pytest.approx(value(joints, "residual"), rel=0.05)
    assert value(path, "path by") == pytest.approx(0.0, abs=1e-4)
    assert value(joints, "path by") > 0.1


def test_shaper_controlled(tmp_path: Path) -> None:
    """Shapers take vibration away and need less torque, with a perfect drive most of all."""
    _, *rows = lines("shaper_controlled.py", tmp_path)
    residual = [columns(row)[1] for row in rows]
    torque = [columns(row)[2] for row in rows]
    assert residual[2] < 0.2 * residual[0]
    assert max(torque[2:]) < min(torque[:2])


def test_imperfection_actuator(tmp_path: Path) -> None:
    """A motor that can't do what it is told follows worse than an ideal one."""
    ideal, saturated, limited, dead, lagging = lines("imperfection_actuator.py", tmp_path)
    assert value(saturated, "peak torque") == 80.0
    for row in (saturated, limited, dead, lagging):
        assert value(row, "tracking error") > value(ideal, "tracking error")


def test_imperfection_delay(tmp_path: Path) -> None:
    """The later the torque, the larger the error, until the loop is unstable; the run says so and goes on."""
    *rows, unknown, known = lines("imperfection_delay.py", tmp_path)
    assert value(known, "tracking error") < 0.3 * value(unknown, "tracking error")
    errors = [value(row, "tracking error") for row in rows if "tracking" in row]
    assert errors == sorted(errors)
    assert "unstable" in rows[-1]


def test_filter_kinds(tmp_path: Path) -> None:
    """A low-pass of the velocity costs delay margin; a setpoint filter doesn't, and makes the robot late."""
    none, low, _, setpoint, _ = lines("filter_kinds.py", tmp_path)
    assert value(low, "delay margin") < 0.8 * value(none, "delay margin")
    assert value(setpoint, "delay margin") == value(none, "delay margin")
    assert value(setpoint, "tracking error") > 20.0 * value(none, "tracking error")


def test_imperfection_payload(tmp_path: Path) -> None:
    """The error is smallest where the controller is right about the payload, and grows to both sides."""
    errors = [float(row.split()[4]) for row in lines("imperfection_payload.py", tmp_path)]
    assert errors.index(min(errors)) == 2
    assert errors[0] > errors[1]
    assert errors[-1] > errors[-2]


def test_export_slaves(tmp_path: Path) -> None:
    """Trajectory, robot and controller are FMUs, and the torques lead from one to the other."""
    rows = lines("export_slaves.py", tmp_path)
    assert {path.name for path in (tmp_path / "fmus").iterdir()} == {"trajectory.fmu", "plant.fmu", "pd.fmu"}
    assert "pd.joint1.torque -> plant.joint1.torque" in rows


def test_all_examples_of_loops_are_tested() -> None:
    """An example that nobody runs would rot."""
    tested = Path(__file__).read_text(encoding="utf-8")
    prefixes = ("controller_", "shaper_", "imperfection_", "custom_", "export_", "filter_kinds")
    mine = [path.name for path in EXAMPLES.glob("*.py") if path.name.startswith(prefixes)]
    assert mine
    assert all(f'"{name}"' in tested for name in mine)


def test_custom_function(tmp_path: Path) -> None:
    """The function controls the robot as it stands and from a scene file, and leaves as an FMU."""
    python, scene_file, exported = lines("custom_function.py", tmp_path)
    assert value(python, "tracking error") < 10.0
    assert value(scene_file, "tracking error") < 20.0
    assert exported.startswith("exported: own_pid.fmu, PID control")
    assert (tmp_path / "fmus" / "own_pid.fmu").is_file()


ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "benchmarks" / "shapers_in_the_loop.py"


@pytest.mark.slow
def test_the_table(tmp_path: Path) -> None:
    """Every combination is there, with the figures of docs/shapers.md; a shaper takes vibration away with every drive, and a controller rests off the end pose
    where the payload is wrong."""
    command = [sys.executable, str(SCRIPT), "--out", str(tmp_path), "--errors", "3", "--only", "unshaped", "zvd"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert outcome.returncode == 0, outcome.stderr
    with (tmp_path / "shapers_in_the_loop.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 2 * 3
    assert "| zvd | 17.0 |" in (tmp_path / "shapers_in_the_loop.md").read_text(encoding="utf-8")
    found = {(row["drive"], row["shaper"], float(row["payload_error"])): row for row in rows}
    for drive in dict.fromkeys(row["drive"] for row in rows):
        for error in (-0.3, 0.0, 0.3):
            shaped, unshaped = (found[drive, shaper, error] for shaper in ("zvd", "unshaped"))
            assert float(shaped["residual_vibration"]) < float(unshaped["residual_vibration"])
            assert float(shaped["peak_torque"]) < float(unshaped["peak_torque"])
            if drive != "perfect drive":
                assert (float(shaped["rest_offset"]) > 1e-4) == (error != 0.0)
    assert_page_agrees(rows)


def assert_page_agrees(rows: Sequence[Mapping[str, str]]) -> None:
    """docs/shapers.md prints these residual vibrations, to its last digit but for rounding."""
    page = (ROOT / "docs" / "shapers.md").read_text(encoding="utf-8")
    for row in rows:
        title = f"### Residual vibration [µm], {row['drive']}, by payload error"
        table = page.split(title)[1].split("\n##")[0]
        line = next(line for line in table.splitlines() if line.startswith(f"| {row['shaper']} |"))
        column = {-0.3: 3, 0.0: 6, 0.3: 9}[round(float(row["payload_error"]), 6)]
        assert float(line.split("|")[column]) == pytest.approx(1e6 * float(row["residual_vibration"]), abs=0.06)
