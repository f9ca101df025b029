"""Tuning: known optima, limits, journals and texts; a loop that is tuned is the scene's own run."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.gains.goals import parse_condition, parse_goal
from flexfmu.cosim.design.gains.trial import Interval, Study, Trial, trial_journal
from flexfmu.cosim.design.gains.tuner import summary, tune_scene, tune_study, write_tuned, write_tuning
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.many.journal import FILE
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene

PD = {"kind": "pd", "proportional": 5e3, "derivative": 60.0, "sample_time": 1e-3}
SCENE = load_scene("barnard2012-6kg").replace(
    {
        "name": "loop",
        "effects.proximal_bending": 1,
        "effects.distal_axial": 0,
        "effects.motor_inertia": 0.1,
        "trajectory.duration": 0.2,
        "trajectory.dwell": 0.02,
        "cosimulation.step": 1e-3,
        "cosimulation.tolerance": 1e-4,
        "cosimulation.drive": "torque",
        "controller": [PD],
    }
)
PAPER, STILL = load_scene("barnard2012-6kg"), SCENE.replace({"trajectory.dwell": 0.0})
KEYS = (Interval("pd.kp", 1e3, 1e5), Interval("pd.kd", 10.0, 500.0))


def known(kp: float, kd: float) -> dict[str, float | None]:
    """A figure whose smallest value, 1, is at kp = 2e4, kd = 80, and another one that grows with both."""
    distance = math.log(kp / 2e4) ** 2 + 3.0 * math.log(kd / 80.0) ** 2 + math.log(kp / 2e4) * math.log(kd / 80.0)
    return {
        "rms_tracking_error_1": 1.0 + distance,
        "rms_tracking_error_2": 0.9,
        "peak_torque_1": kp * kd,
        "peak_torque_2": 1.0,
    }


class Known(Study):
    """A study whose figures are known; beyond a derivative gain of 400 every trial fails."""

    def tried(self, values: tuple[float, ...]) -> Trial:
        """The known figures."""
        kp, kd = values or (5e3, 60.0)
        return Trial(values, {}, "unstable") if kd > 400.0 else Trial(values, known(kp, kd))


def study(*conditions: str) -> Known:
    """A study of the known figures."""
    return Known(SCENE, KEYS, parse_goal("rms_tracking_error"), tuple(parse_condition(each) for each in conditions))


def test_a_known_optimum_is_found() -> None:
    """Within 2 % of the gains, although a part of the interval fails; the figure within 1e-3 of the smallest."""
    result = tune_study(study(), method="trust-region")  # another name of the method by gradients
    assert result.best.values == pytest.approx((2e4, 80.0), rel=0.02)
    assert result.study.minimise.of(result.best.figures) == pytest.approx(1.0, abs=1e-3)
    assert result.is_feasible
    assert result.scene.controller[0].proportional == (result.values["pd.kp"],) * 2  # type: ignore[union-attr]
    assert any(each.message for each in result.trials)


def test_a_condition_holds_and_is_used_up() -> None:
    """With kp kd < 4e5 the optimum is on the limit: by Lagrange's rule at kp = 7135, kd = 56.06, where the figure is 2.84."""
    result = tune_study(study("peak_torque < 4e5"), trials=160)
    assert result.is_feasible
    figures = result.best.figures
    assert 3.9e5 < (figures["peak_torque_1"] or 0.0) <= 4e5
    # the smallest value on the limit: with a + b = c, a² + 3 b² + a b is 11 c²/12 at b = c/6
    c = math.log(4e5 / (2e4 * 80.0))
    assert result.study.minimise.of(figures) == pytest.approx(1.0 + 11.0 * c**2 / 12.0, rel=0.02)


def test_limits_that_none_keeps_are_missed_least() -> None:
    """The result says so, and has the values with the smallest excess."""
    result = tune_study(study("peak_torque < 1e3"), trials=60)
    assert not result.is_feasible
    assert result.best.values == pytest.approx((1e3, 10.0), rel=0.05)
    # the page names what is missed, in red
    missed = (
        r'class="over">no trial keeps all limits: Peak torque, both joints [\d.e+]+ N·m, limit &lt; 1000 N·m</span>'
    )
    assert re.search(missed, result.page())
    assert len(re.findall('class="over">', result.page())) == 5
    # every line is in the legend, that of the given values too
    legend = result.plot().axes[0].get_legend()
    assert legend is not None
    assert {"misses a limit", "given"} <= {text.get_text() for text in legend.get_texts()}


def test_an_interrupted_tuning_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The journal has every trial; the same command makes the others alone and ends with the same trials, torn lines or not."""
    whole = tune_study(study(), trials=40)
    begun = trial_journal(tmp_path, study())
    made: list[tuple[float, ...]] = []

    def interrupted(_: Known, values: tuple[float, ...]) -> Trial:
        made.append(values)
        if len(made) == 23:
            raise KeyboardInterrupt
        return usual(study(), values)

    usual = Known.tried
    monkeypatch.setattr(Known, "tried", interrupted)
    first = tune_study(study(), trials=40, journal=begun)
    assert first.interrupted
    assert first.trials == whole.trials[:22]
    with (tmp_path / FILE).open("a") as file:
        file.write('{"values": [1')
    said = list[str]()
    again = trial_journal(tmp_path, study(), note=said.append, total=40)
    assert said == ["continuing: 22 of 40 done"]
    made.clear()
    second = tune_study(study(), trials=40, journal=again)
    assert (second.trials, len(made)) == (whole.trials, 18)
    other = replace(study(), over=(KEYS[0], Interval("pd.kd", 20.0, 500.0), Interval("payload.mass", 1.0, 2.0)))
    with pytest.raises(InputError, match="has another tuning: keys was"):
        trial_journal(tmp_path, other)
    assert whole.trials[0].values in again
    assert whole.trials[0].values not in trial_journal(tmp_path, other, restart=True)


def test_infinite_margins_keep_limits_and_are_null_in_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A delay margin is infinite where no delay that is tried makes the loop unstable; the journal reads it back."""

    usual = Known.tried

    def robust(_: Known, values: tuple[float, ...]) -> Trial:
        trial = usual(wish, values)
        return trial if trial.message else replace(trial, figures={**trial.figures, "delay_margin": math.inf})

    wish = study("delay_margin>1ms")
    monkeypatch.setattr(Known, "tried", robust)
    result = tune_study(wish, trials=30, journal=trial_journal(tmp_path, wish))
    assert result.is_feasible
    assert summary(result)["conditions"][0]["tuned"] is None
    assert len(write_tuning(result, tmp_path)) == 3
    known = trial_journal(tmp_path, wish)
    assert all(known.kept(each.values, Trial, pytest.fail) == each for each in result.trials)


def test_all_trials_that_fail_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the reason of the first one, that of the scene itself."""
    monkeypatch.setattr(Known, "tried", lambda _, values: Trial(values, {}, f"fell over with {len(values)}"))
    with pytest.raises(ResultsError, match="all 10 trials failed, the first one: fell over with 0"):
        tune_study(study(), trials=10)


@given(low=st.floats(1e-6, 1e6), ratio=st.floats(1.001, 1e6), share=st.floats(0.0, 1.0))
@settings(max_examples=200)
def test_shares_and_values_belong_to_each_other(low: float, ratio: float, share: float) -> None:
    """A value lies within its interval, and its share is the one it was made from, but for the rounding to five digits."""
    interval = Interval("x", low, low * ratio)
    value = interval.at(share)
    assert interval.low <= value <= interval.high
    rounding = 1e-4 * (1.0 if interval.is_logarithmic else value / (interval.high - interval.low))
    assert interval.share_of(value) == pytest.approx(share, abs=max(rounding, 1e-9))


@pytest.mark.parametrize(
    ("text", "upper", "limit"),
    [
        ("peak_torque_1<80", True, 80.0),
        ("peak_torque <= 80000 mN·m", True, 80.0),
        ("phase_margin > 45°", False, math.pi / 4.0),
        ("settling_time<20ms", True, 0.02),
        ("residual_vibration_amplitude < 5e1um", True, 5e-5),
        ("rms_tracking_error_1<0.1deg", True, 0.1 * math.pi / 180.0),
        ("margin>6dB", False, 10.0**0.3),
        ("gain_margin>2", False, 2.0),
    ],
)
def test_conditions_have_their_units(text: str, upper: bool, limit: float) -> None:
    """SI units without one; names without a joint are both joints."""
    found = parse_condition(text)
    assert (found.limit.is_upper, found.limit.limit) == (upper, pytest.approx(limit, rel=1e-15))
    assert parse_goal("peak_torque").parts == ("peak_torque_1", "peak_torque_2")
    # both joints must keep a limit: the excess of each, relative to it
    figures = {"peak_speed_1": 3.0, "peak_speed_2": 5.0}
    assert parse_condition("peak_speed<4").excesses(figures) == [-0.25, 0.25]
    assert parse_condition("peak_speed>4").excesses({**figures, "peak_speed_1": None}) == [math.inf, -0.25]


@pytest.mark.parametrize(
    ("over", "options", "message"),
    [
        ([], {}, "needs keys and intervals"),
        (["pd.kp"], {}, "--over takes KEY=FROM:TO"),
        (["pd.kp=1e3"], {}, "an interval FROM:TO of two numbers"),
        (["pd.kp=1e4:1e3"], {}, "from a smaller to a larger number"),
        (["pd.kp=nan:1e3"], {}, "from a smaller to a larger number"),
        (["pd.kp=-1:1e3"], {}, "must be at least 0"),
        (["pd.gain=1:2"], {}, "is not a known key"),
        (["pd.kp=1:2", "controller[0].proportional=1:2"], {}, "is there twice"),
        (["pd.kp=1e3:1e5"], {"minimise": "rms_tracking"}, "did you mean 'rms_tracking_error"),
        (["pd.kp=1e3:1e5"], {"minimise": "inertia_ratio"}, "needs a section"),
        (["pd.kp=1e3:1e5"], {"subject_to": ["peak_torque=80"]}, "a condition is FIGURE<LIMIT"),
        (["pd.kp=1e3:1e5"], {"subject_to": ["peak_torque<1e999"]}, "a condition is FIGURE<LIMIT"),
        (["pd.kp=1e3:1e5"], {"subject_to": ["peak_torque<80ms"]}, "is in N.m, N·m, Nm, .*, not in ms"),
        (["pd.kp=1e3:1e5"], {"subject_to": ["margin>6deg"]}, "is in dB, not in deg"),
        (["pd.kp=1e3:1e5"], {"method": "simplex"}, "choose from gradient, sample"),
        (["pd.kp=1e3:1e5"], {"trials": 1}, "at least 2 trials"),
        (["pd.kp=1e3:1e5"], {"payload_band": 1.5}, "above 0 and below 1"),
        # figures that a robot lacks: without a controller, without a dwell
        (["payload.mass=1:2"], {"scene": PAPER}, "has no rms_tracking_error: it needs"),
        (["payload.mass=1:2"], {"scene": PAPER, "minimise": "sensitivity_peak"}, "has no sensitivity_peak: it needs"),
        (["pd.kp=1e3:1e5"], {"scene": STILL, "minimise": "settling_time"}, r"it needs `trajectory\.dwell`"),
    ],
)
def test_wrong_wishes_are_told_before_a_run(over: list[str], options: dict[str, Any], message: str) -> None:
    """Nothing is simulated."""
    with pytest.raises((InputError, SceneError), match=message):
        tune_scene(**{"scene": SCENE, "over": over, **options})


@pytest.mark.slow
def test_margins_are_those_of_the_loop() -> None:
    """Worst at start and end of the path; a trial that is unstable about a pose has failed, though its motion is short."""
    result = tune_scene(SCENE, {"pd.kd": (20.0, 120.0)}, subject_to=["margin>3dB", "phase_margin>1deg"], trials=4)
    for trial in result.trials[:2]:
        scene = result.study.changed(trial.values)
        found = flexfmu.margins(scene, poses=2)
        assert found.is_stable != bool(trial.message)
        if found.is_stable:
            assert trial.figures["gain_margin"] == pytest.approx(found.worst.gain_margin, rel=1e-12)
            assert trial.figures["phase_margin"] == pytest.approx(found.worst.phase_margin, rel=1e-12)
    assert result.is_feasible
    margin = result.metrics.phase_margin
    assert (margin, margin.unit) == (result.best.figures["phase_margin"], "rad")
    assert "unstable" in result.study.tried((2e3,)).message


def command(*arguments: object) -> Result:
    """Run `flexfmu tune`."""
    return CliRunner().invoke(app, ["tune", *map(str, arguments)])


@pytest.mark.slow
def test_a_tuned_loop_is_the_scenes_own_run(tmp_path: Path) -> None:
    """Better than given within the limit; the file keeps comments, and its run has the figures that were found."""
    made = tune_scene(SCENE, {"pd.kp[0]": (4e3, 5e3)}, trials=2, method="sample")
    source = write_tuned(made, tmp_path / "made.toml")
    source.write_text(source.read_text().replace("[[controller]]", "# the loop\n[[controller]]"))
    options = ["--over", "pd.kp=4e3:2e4,pd.kd=40:120", "--subject-to", "peak_torque<900", "--trials", 10, "--json"]
    options += ["--out", tmp_path / "out", "-o", tmp_path / "tuned.toml"]
    options += ["--set", "payload.mass=5.0", "--payload-band", 0.1]
    result = command(source, *options)
    assert result.exit_code == 0, result.output
    data = json.loads(result.stdout)
    assert data["within_limits"]
    assert data["trials"] == 10
    assert data["minimise"]["tuned"] < data["minimise"]["given"]
    text = (tmp_path / "tuned.toml").read_text()
    assert "# the loop" in text
    tuned = load_scene(tmp_path / "tuned.toml")
    assert tuned.payload.mass == 5.0
    # the worst of three payloads, from runs of their own
    errors = [{"imperfection": [{"kind": "payload-error", "relative": each}]} for each in (-0.1, 0.0, 0.1)]
    runs = [metrics_of(flexfmu.run(tuned.replace(each))) for each in errors]
    for name, found in ((data["minimise"]["name"], data["minimise"]), ("peak_torque", data["conditions"][0])):
        expected = max(each[f"{name}_{joint}"] or 0.0 for each in runs for joint in (1, 2))
        assert found["tuned"] == pytest.approx(expected, rel=1e-9)
    # again, from the journal alone: the same bytes
    before = (tmp_path / "out" / "tune.csv").read_bytes()
    shown = command(source, *[each for each in options if each != "--json"])
    assert "pd.kp [N·m/rad]" in shown.stdout
    assert (tmp_path / "out" / "tune.csv").read_bytes() == before
