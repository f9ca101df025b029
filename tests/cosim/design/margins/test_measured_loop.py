"""Margins with a measured plant are those of a model of that plant, whatever model the loop is of, and within their standard errors."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from math import nan, pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import control
import numpy as np
import pytest
from scipy.optimize import brentq
from typer.testing import CliRunner

import flexfmu
from flexfmu import FrequencyResponse
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.margins.margins import FIGURES, pose_margins
from flexfmu.cosim.design.margins.measured_loop import MeasuredLoop, measured_margins
from flexfmu.model.contract import LinearPlant

sys.path.insert(0, str(Path(__file__).parent))

from test_drawn_loops import stable

EXAMPLES = Path(__file__).parents[4] / "examples"
TOLERANCES = dict.fromkeys(FIGURES, 0.01) | {"delay_margin": 0.03}
"""Relative; how aliases move a delay's margin is as with the wrong model."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5, 7])
def test_margins_are_those_of_a_model_of_the_measured_plant(seed: int) -> None:
    """The loop's model has modes of other frequencies and damping: within the response's band that doesn't matter, with two rates neither."""
    truth = stable(seed, 0.05)
    assert truth is not None
    x, n = truth.continuous, len(truth.continuous.a) // 2
    a = x.a.copy()
    a[n:] *= np.where(np.arange(2 * n) < n, 1.15, 1.5)
    model = replace(truth, continuous=replace(x, a=a))
    names, outputs = [f"u{i}" for i in range(len(truth.channels))], tuple(f"y{i}" for i in range(len(x.c)))
    f = np.geomspace(0.05, 3000.0, 1000)
    states = np.linalg.solve(2j * pi * f[:, None, None] * np.eye(2 * n) - x.a, x.channels[0] + 0j * f[:, None, None])
    response = FrequencyResponse(f, x.c @ states, tuple(names), outputs)
    plant = LinearPlant(a, x.channels[0], x.c, x.channels[1], tuple(names), outputs, (np.zeros(0), np.zeros(0)))
    wired: Any = SimpleNamespace(
        signal_paths=lambda: [(y, []) for y in outputs], through_lags=lambda _: (None, []), plant=0
    )
    own, wanted = (pose_margins(each, names, nan, (nan, nan), (nan, nan)) for each in (model, truth))

    def found(scale: float) -> Any:
        scaled = FrequencyResponse(f, scale * response.response, tuple(names), outputs)
        return measured_margins(MeasuredLoop(model, names, wired, plant, scaled), names, own)

    for row, known in zip(found(1.0).loops, wanted.loops, strict=True):
        for name, tolerance in TOLERANCES.items():
            assert getattr(row, name) == pytest.approx(getattr(known, name), rel=tolerance, abs=1e-3), (
                row.channel,
                name,
            )
    # encirclements tell on which side of its gain margin the loop is
    margin = min(wanted.loops[-1].gain_margin, 50.0)
    assert found(0.97 * margin).is_stable
    assert not found(1.03 * margin).is_stable


def test_a_model_of_ones_own_has_the_margins_of_python_control() -> None:
    """The response of another axis, held and continuous, in the loop of a model: python-control has that axis itself."""
    axis = flexfmu.second_order(
        "axis",
        q={"angle": flexfmu.variable(0.0, "rad")},
        u={"torque": flexfmu.variable(0.0, "N.m")},
        residual=lambda v, a, u: 0.1 * a.angle + 0.5 * v.angle - u.torque,
    )
    servo = control.ss([], [], [], [[-20.0, -1.0]], 1e-3, inputs=["angle", "rate"], outputs=["torque"])
    wires = {"axis.torque": "controller.torque", "controller.angle": "axis.angle", "controller.rate": "axis.der(angle)"}
    other = control.ss(
        [[0.0, 1.0], [-300.0, -2.0]],
        [[0.0], [14.0]],
        np.eye(2),
        0.0,
        inputs=["torque"],
        outputs=["angle", "der(angle)"],
    )
    held = control.sample_system(other, 1e-3)
    loop = control.ss([], [], [], [[20.0, 1.0]], 1e-3) * held
    phase = control.stability_margins(FrequencyResponse.of(loop, np.geomspace(0.1, 499.9, 4000)).to_control())[1]
    critical = brentq(lambda k: np.abs(control.poles(control.feedback(k * loop))).max() - 1.0, 50.0, 500.0)
    responses = (
        FrequencyResponse.of(held, np.geomspace(0.1, 500.0, 400)),
        FrequencyResponse.of(other, np.geomspace(0.1, 4e4, 800)),
    )
    for response in (*responses, replace(responses[1], outputs=("angle", "rate"))):
        if "rate" in response.outputs:
            with pytest.raises(flexfmu.InputError, match=r"takes der\(angle\), which the response lacks"):
                flexfmu.margins([axis, servo], wires, response=response)
            continue
        found = flexfmu.margins([axis, servo], wires, response=response).worst
        assert found.gain_margin == pytest.approx(critical, rel=2e-3)
        assert found.phase_margin == pytest.approx(np.radians(phase), rel=1e-3)
        assert found.disk_margin < 2.0
        assert found.gain_margin.error is None


@pytest.mark.slow
def test_the_commands_take_a_response(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The model's own response, in a file with standard errors, gives the model's margins with standard errors; and a tuning in which it judges."""
    monkeypatch.chdir(tmp_path)
    settings = ("shaper=[]", "imperfection=[{kind='encoder', counts_per_turn=1e6, window=1}]", "trajectory.dwell=0.1")
    scene = (str(EXAMPLES / "controller_scene.toml"), *(part for each in settings for part in ("--set", each)))
    robot = flexfmu.load_scene(scene[0]).replace({"effects.joint_friction.coulomb": 0.0})
    plant = flexfmu.linearize(robot, (0.175, 0.320), ["joint1.position", "joint2.position"])[:, :2]
    own = FrequencyResponse.of(control.sample_system(plant, 5e-4), np.geomspace(1.0, 900.0, 150))
    replace(own, standard_error=2e-3 * np.abs(own.response)).write("plant.csv")

    def ran(*arguments: str) -> Any:
        result = CliRunner().invoke(app, [*arguments, "--json"])
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    model, measured = (
        ran("margins", *scene, *more) for more in (("--poses", "1"), ("--response", "plant.csv", "--out", "out"))
    )
    for name in ("gain_margin", "phase_margin", "delay_margin", "disk_margin", "sensitivity_peak", "crossover"):
        assert measured["worst"][name] == pytest.approx(model["worst"][name], rel=2e-3)
        assert all(0.0 < row[name] < 0.02 * model["worst"][name] for row in measured["standard_errors"])
    assert {each.name for each in (tmp_path / "out").iterdir()} == {
        "margins.csv",
        "margins.html",
        "bode.png",
        "nyquist.png",
    }
    tuned = ran(
        "tune", *scene, "--over", "pd.derivative=20:60", "--subject-to", "gain_margin>6dB", "--response", "plant.csv", "--trials", "2", "-j", "1",
    )  # fmt: skip
    assert tuned["within_limits"]
    found = ran("response", "plant.csv", "--modes", "3", "--out", "modes")
    assert [each["frequency"] for each in found["modes"][1:]] == pytest.approx([140.4, 147.5], abs=1.5)
    assert (tmp_path / "modes" / "response.png").exists()
    again = FrequencyResponse.read("modes/response.csv")
    np.testing.assert_allclose(again.response, own.response, rtol=1e-9)
