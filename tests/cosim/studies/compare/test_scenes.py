"""Controllers and shapers side by side: scenes with their processor times, and with payloads that the loops don't know."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import flexfmu as command

import flexfmu
from flexfmu.cosim.design.gains.robustness import band_masses, parse_band
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.cosim.studies.compare.comparison import Comparison
from flexfmu.model.scene.errors import SceneError

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
