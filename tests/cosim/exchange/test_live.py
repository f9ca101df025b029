"""A run in the page: the module's bits are the run's, in Node and in Chromium; sliders draw it anew; what can't be simulated is said."""

from __future__ import annotations

import base64
import importlib
import json
import random
import re
import shlex
import shutil
import socket
import subprocess
import time
import warnings
from collections.abc import Iterator
from html import unescape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import flexfmu as run_command

import flexfmu
from flexfmu.cosim.cli.console import load_changed
from flexfmu.cosim.design.scene_files import write_changed
from flexfmu.cosim.exchange.live import LiveRun, live_run, simulating
from flexfmu.cosim.experiment.run_checks import divergence
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import OF_BOTH, definition, display
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.metrics.motors import motor_loads
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[3] / "examples"
LARGEST_PAGE, LARGEST_PACKED = 1_000_000, 700_000
"""Sizes of a page, and of what it simulates with [bytes]."""

SCRIPT = """
const { readFileSync } = await import("node:fs"), vm = await import("node:vm");
const [interface_, script, packed, options] = process.argv.slice(2);
vm.runInThisContext(readFileSync(interface_, "utf8").replaceAll("export ", ""));
vm.runInThisContext(readFileSync(script, "utf8"));
const { simulations: [simulation] } = await Simulation.load(readFileSync(packed, "utf8")), asked = JSON.parse(options);
const bytes = (values) => Buffer.from(Float64Array.from(values).buffer).toString("base64");
const found = asked.map(({ values, ...options }) => {
  const run = simulation.run(values ? simulation.options(values) : options), signals = {};
  for (const [name, [, rows]] of Object.entries(simulation.facts.rows)) signals[name] = rows.map((_, order) => bytes(run.signal(name, order)));
  return { time: bytes(run.time), signals, metrics: run.metrics, failure: run.failure, state: run.state, command: simulation.command(values ?? {}), scene: simulation.facts.scene && simulation.scene(values ?? {}) };
});
console.log(JSON.stringify(found));
"""


def stiction() -> Scene:
    """The paper's robot under a PD law, with friction that sticks."""
    friction = {"kind": "stiction", "coulomb": 2.0, "breakaway": 3.0, "viscous": 0.5}
    controller = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
    changes = {"cosimulation.drive": "torque", "effects.joint_friction": friction, "effects.motor_inertia": 0.1}
    return load_scene("barnard2012-6kg").replace({**changes, "controller": [controller]})


LOOP = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "mechanism.proximal.inner_diameter": 0.025,
    "effects.gravity": [1.0, -9.81],
    "trajectory.duration": 0.6,
    "trajectory.dwell": 0.1,
}
"""A robot under a controller, on a hollow arm, leaning."""

PD = {"kind": "pd", "proportional": [5e3, 4e3], "derivative": 50.0, "sample_time": 1e-3}

PULSE = {"kind": "pulse", "signal": "force.x", "amplitude": 10.0, "start": 0.1234567, "duration": 0.05}

SCENES: dict[str, Any] = {
    "barnard2012-6kg": "barnard2012-6kg",
    "barnard2012-0.1kg": "barnard2012-0.1kg",
    "starter": "starter",
    "loop": EXAMPLES / "controller_scene.toml",
    "stiction": None,
    "sampled shaper": {"shaper": [{"kind": "zv", "apply": "sampled", "sample_time": 1e-3}]},
    "delays": {
        **LOOP,
        "controller": [PD],
        "imperfection": [{"kind": "delay", "signal": "position", "time": 4e-4}, {"kind": "delay", "time": 1e-3}],
    },
    "disturbed": {
        **LOOP,
        "controller": [PD, {"kind": "feedforward", "robot": "flexible", "sample_time": 1e-3}],
        "disturbance": [PULSE, {"kind": "payload", "dropped": 0.30003}],
    },
}
"""Shipped scenes, files, and changes of the 6 kg scene."""


@pytest.fixture(scope="module", autouse=True)
def zig() -> None:
    """Skips where nothing compiles to WebAssembly."""
    pytest.importorskip("ziglang")


def simulated(run: Run | LiveRun, folder: Path, *asked: dict[str, Any]) -> list[dict[str, Any]]:
    """Runs in Node, with these options of ``Simulation.run``."""
    node = pytest.importorskip("playwright._impl._driver").compute_driver_executable()[0]
    live = live_run(run) if isinstance(run, Run) else run
    assert live.reason == ""
    packed = simulating([("", live)]).packed
    assert len(packed) < LARGEST_PACKED
    for name, text in (("run.mjs", SCRIPT), ("packed", packed)):
        (folder / name).write_text(text)
    scripts = ("flexfmu.fmu_build", "fmu.js"), ("flexfmu.cosim.reports", "simulation.js")
    paths = [str(files(package) / "templates" / name) for package, name in scripts]
    command = [node, folder / "run.mjs", *paths, folder / "packed", json.dumps(asked)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found: list[dict[str, Any]] = json.loads(done.stdout)
    assert [each["failure"] for each in found] == [""] * len(asked)
    return found


def numbers(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text))


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("name", SCENES)
def test_node_gives_the_bits_of_the_run(name: str, tmp_path: Path) -> None:
    """All signals with their derivatives, of all shipped scenes, loops with encoder, lag and delays, friction that sticks; so do the metrics."""
    scene = SCENES[name] or stiction()
    run = flexfmu.run(load_scene("barnard2012-6kg").replace(scene) if isinstance(scene, dict) else scene)
    (found,) = simulated(run, tmp_path, {})
    assert numbers(found["time"]).tobytes() == run.recording.time.tobytes()
    for signal, orders in found["signals"].items():
        column = run.recording[signal]
        for order, text in enumerate(orders):
            expected = (column.values, column.first, column.second)[order]
            assert expected is not None
            np.testing.assert_array_equal(numbers(text), expected, err_msg=f"{signal} {order}")
    own = measure_run(run, 0)
    assert found["metrics"].keys() == {name for name in own if not name.startswith("inertia_ratio")}
    for metric, value in found["metrics"].items():
        expected = own[metric].value
        assert (value is None) == (expected is None)
        assert value is None or value == pytest.approx(expected, rel=1e-9, abs=1e-12), metric


def test_sliders_are_runs_with_other_parameters(tmp_path: Path) -> None:
    """A payload, a gain, a duration, a step: what `flexfmu run --set` gives, to the accuracy of a motion that is planned anew."""
    scene = load_scene("barnard2012-6kg")
    asked = {"parameters": {"payload.mass": 4.0}}, {"stretch": 1.25}, {"step": 1e-4, "tolerance": 1e-7}
    changed = (
        {"payload.mass": 4.0},
        {"trajectory.duration": 0.43 * 1.25},
        {"cosimulation.step": 1e-4, "cosimulation.tolerance": 1e-7},
    )
    for found, changes in zip(simulated(flexfmu.run(scene), tmp_path, *asked), changed, strict=True):
        expected = measure_run(flexfmu.run(scene.replace(changes)), 0)
        for name, value in found["metrics"].items():
            assert value == pytest.approx(expected[name].value, rel=2e-7), (name, changes)
    loop = stiction()
    gains = {"parameters": {f"pd.joint{i}.proportional_gain": 2e4 for i in (1, 2)}}
    (found,) = simulated(flexfmu.run(loop), tmp_path, gains)
    expected = measure_run(flexfmu.run(loop.replace({"controller.pd.proportional": 2e4})), 0)
    assert found["metrics"]["peak_torque_1"] == pytest.approx(expected["peak_torque_1"].value, rel=1e-9)


COPIED: dict[str, dict[str, Any]] = {
    "rigid drive": {
        "effects.damping": {"kind": "stiffness", "time": 1e-4},
        "trajectory.profile": {"kind": "bang-bang"},
    },
    "shaper": {"shaper": [{"kind": "zv"}], "payload.mass": 3.0},
    "thick beams": {
        "effects": {
            "gravity": [0.0, -9.81],
            "basis": "craig-bampton",
            "proximal_bending": 2,
            "distal_axial": 1,
            "distal_bending": 1,
            "beam": "timoshenko",
            "damping": {"kind": "modal", "ratio": 0.1357},
        }
    },
    "payload error": {
        **LOOP,
        "controller": [PD, {"kind": "feedforward", "sample_time": 1e-3}],
        "imperfection": [
            {"kind": "payload-error", "relative": 0.1},
            {"kind": "encoder", "counts_per_turn": 1e5},
            {"kind": "delay", "signal": "velocity", "time": 2e-4},
            {"kind": "lag", "time_constant": 2e-4, "sample_time": 1e-4},
        ],
    },
    "named lag": {
        **LOOP,
        "trajectory.duration": 0.5,
        "controller": [{**PD, "proportional": 3e3}, {"kind": "gravity-feedforward", "sample_time": 1e-3}],
        "imperfection": [
            {"kind": "lag", "name": "motor", "time_constant": 1e-4, "sample_time": 1e-4},
            {"kind": "delay", "time": 4e-4, "sample_time": 1e-4},
            {"kind": "saturation", "limit": 90.0},
        ],
    },
    "PD alone": {**LOOP, "controller": [PD], "disturbance": [PULSE, {"kind": "payload", "dropped": 0.4, "mass": 1.0}]},
}
"""Changes of the 6 kg scene whose copies are run."""


@pytest.mark.slow
def test_a_copied_command_has_the_chosen_effects(tmp_path: Path) -> None:
    """Without the account of the choice, which is longer than all else; and the tolerance that the choice filled in."""
    auto = {"gravity": [0.0, -9.81], "select": "auto", "tolerance": 0.05, "of": ["peak_torque_1"]}
    path = write_changed("barnard2012-6kg", tmp_path / "auto.toml", {"effects": auto, "cosimulation": {"step": 2e-4}})
    run = flexfmu.run(path)
    live = live_run(run)
    assert "choice" not in dict(live.facts["settings"])["effects"]
    (found,) = simulated(live, tmp_path, {})
    copied = load_changed(str(path), [each for each in shlex.split(found["command"])[3:] if each != "--set"])
    assert copied.effects == run.scene.effects.model_copy(update={"choice": None})
    assert copied.cosimulation == run.scene.cosimulation


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("name", COPIED)
def test_copies_run_what_the_page_runs(name: str, tmp_path: Path) -> None:
    """Command line and scene of drawn sliders, each alone and all together, are one scene, through the real parser, and its run gives the
    page's metrics, that of the command too."""
    path = write_changed("barnard2012-6kg", tmp_path / "own robot.toml", {**COPIED[name], "name": "own"})
    draw = random.Random(name)
    live = live_run(flexfmu.run(path))
    sliders = live.facts["sliders"]
    assert len({each["name"] for each in sliders}) == len(sliders)
    some = draw.sample(sliders, 3)
    asked = [{each["name"]: float(f"{draw.uniform(each['low'], each['high']):.4g}")} for each in some]
    # not to the ends, where all together may be unstable
    asked.append(
        {each["name"]: float(f"{each['value'] * draw.uniform(0.95, 1.05):.4g}") for each in sliders} | {"accuracy": 1}
    )
    for found in simulated(live, tmp_path, *({"values": each} for each in asked)):
        words = shlex.split(found["command"])
        assert words[:3] == ["flexfmu", "run", str(path)]
        (tmp_path / "copied.toml").write_text(found["scene"])
        copied = load_scene(tmp_path / "copied.toml")
        assert load_changed(words[2], [each for each in words[3:] if each != "--set"]) == copied
        # a loop with quantised angles amplifies rounding
        shown = {name: each and pytest.approx(each, rel=1e-6, abs=1e-9) for name, each in found["metrics"].items()}
        own = measure_run(flexfmu.run(copied), 0)
        assert {name: own[name].value for name in shown} == shown, found["command"]
    run_command(*words[1:], "--out", str(tmp_path / "out"), "--no-report", "--no-verify")
    by_command = json.loads((tmp_path / "out" / "summary.json").read_text())["metrics"]
    assert {name: by_command[name] for name in shown} == shown


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
def test_a_loop_is_unstable_in_the_page_as_on_the_command_line(tmp_path: Path) -> None:
    """What counts as far off depends on the speed of the motion, which is that of the page's duration."""
    limited = {**LOOP, "controller": [PD], "imperfection": [{"kind": "saturation", "limit": 60.0}]}
    scene, states = load_scene("barnard2012-6kg").replace(limited), set()
    stretches = [0.25, 1.0 / 3.0, 1.0]
    for found, stretch in zip(
        simulated(flexfmu.run(scene), tmp_path, *({"stretch": each} for each in stretches)), stretches, strict=True
    ):
        expected = divergence(flexfmu.run(scene.replace({"trajectory.duration": 0.6 * stretch})))
        assert found["state"] == ("Unstable" if expected else ""), stretch
        states.add(found["state"])
    assert len(states) == 2


@pytest.mark.parametrize("profile", ["trapezoidal", "bang-bang"])
def test_accelerations_jump_at_the_end_of_another_duration(profile: str, tmp_path: Path) -> None:
    """Behind the end the references rest: the residual vibration is that of a motion that is planned anew."""
    kind = {"kind": profile, **({"ramp": 0.25} if profile == "trapezoidal" else {})}
    scene = load_scene("barnard2012-6kg").replace({"trajectory.profile": kind})
    (found,) = simulated(flexfmu.run(scene), tmp_path, {"stretch": 1.1})
    expected = measure_run(flexfmu.run(scene.replace({"trajectory.duration": 0.43 * 1.1})), 0)
    for name, value in found["metrics"].items():
        assert value == pytest.approx(expected[name].value, rel=1e-9), name


def test_sliders_end_where_values_become_impossible() -> None:
    """The inner diameter stays below the outer one, wherever both are; a damping ratio stays in its range; gravity keeps its sign."""
    changes = {"mechanism.proximal.inner_diameter": 0.030, "effects.damping.ratio": 0.6}
    scene = load_scene("barnard2012-6kg").replace(changes)
    sliders = {each["name"]: each for each in live_run(flexfmu.run(scene)).facts["sliders"]}
    outer, inner = sliders["proximal.diameter"], sliders["proximal.inner_diameter"]
    assert 0.030 < inner["high"] <= outer["low"] < 0.035
    scene.replace({outer["key"]: outer["low"], inner["key"]: inner["high"]})
    assert sliders["gravity.y"]["value"] == -9.81
    for each in sliders.values():
        for end in (each["low"], each["high"]):
            scene.replace({each["key"]: end})


def test_what_stays_as_recorded_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller in Python by its name, and steps that are controlled; the page says so."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    springs = importlib.import_module("custom_controller").SpringsAndDampers(1e4, 100.0)
    scene = load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
    run = flexfmu.run(scene, controllers=[springs])
    assert "there is no C of springs (SpringsAndDampers). All is as recorded." in run.live().html
    run = flexfmu.run(scene.replace({"cosimulation.step_control": {"tolerance": 1e-4}}))
    assert live_run(run).reason == "its communication steps are controlled"
    cycles = {"trajectory.way_back": "same-path", "trajectory.cycles": 2}
    assert live_run(flexfmu.run(scene.replace(cycles))).reason == "its motion repeats"


def test_a_page_simulates(browser: Any, tmp_path: Path) -> None:
    """From file://: bits of the recording, figures that follow a slider, its state in the address, and the command; below 1 MB, without errors or requests, on a phone too."""
    name = "barnard2012-6kg"
    run = flexfmu.run(name)
    path = run.live_report(tmp_path / "x.html")
    assert path.stat().st_size < LARGEST_PAGE
    # without scripts there is nothing that promises more than a picture
    plain = browser.new_context(java_script_enabled=False).new_page()
    plain.goto(f"file://{path}")
    assert "Loading" not in plain.locator("main").inner_text()
    assert not any(each.is_visible() for each in plain.locator("button, input").all())
    assert plain.locator("svg.plain").first.is_visible()
    plain.context.close()
    page, problems = browser.new_page(viewport={"width": 1400, "height": 900}), list[str]()
    page.on("console", lambda message: problems.append(message.text))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda request: problems.append(request.url))
    page.goto(f"file://{path}")
    page.locator("#live.ready").wait_for()
    shown = page.evaluate("Array.from(page.live.usual.signal('joint1.torque', 1))")
    np.testing.assert_array_equal(shown, run.recording["joint1.torque"].first)
    field = page.get_by_role("spinbutton", name="youngs")
    assert (field.input_value(), field.locator("xpath=..").inner_text().strip()) == ("70", "GPa")
    # a slider, of which zoomed charts show the curves too, beside the recorded ones
    torques = "page.charts.find(each => each.key === 'torques')"
    page.evaluate(f"{torques}.zoom([0.1, 0.2])")
    painted = f"{torques}.panels[0].plot.ctx.canvas.toDataURL()"
    before_slider = page.evaluate(f"({torques}.body.scrollIntoView(), {painted})")
    tile, before = (
        page.locator(".tile [data-metric=peak_torque]"),
        page.locator(".tile [data-metric=peak_torque]").inner_text(),
    )
    slider = page.get_by_role("slider", name="payload.mass")
    slider.fill("0.4")
    page.wait_for_timeout(800.0)
    assert tile.inner_text() != before
    assert page.evaluate(painted) != before_slider
    low, high = page.evaluate(f"{torques}.panels[0].shown.y")
    drawn = page.evaluate(
        f"{torques}.panels[0].curves.flatMap(c => [c, c.ghost]).flatMap(({{ x, y }}) => [...y].filter((_, i) => x[i] > 0.1 && x[i] < 0.2))"
    )
    assert (low, high) == pytest.approx((min(drawn), max(drawn)), abs=0.06 * np.ptp(drawn))
    mass = float(page.url.partition("#payload.mass=")[2])
    own = run.parameters.get("payload.mass", run.scene.payload.mass)
    assert mass == pytest.approx(own * 3.0**0.4, rel=1e-3)
    page.get_by_role("button", name="copy as command").click()
    assert page.locator(".command").inner_text() == f"flexfmu run {name} --set 'payload.mass={mass:g}'"
    # the natural frequencies are those of the recorded robot
    remarks = "Natural frequencies of the changed robot aren't known: the spectrum shows none."
    assert page.locator(".remarks").inner_text() == remarks
    page.locator("figure", has=page.locator("h3", has_text="Spectrum")).scroll_into_view_if_needed()
    page.wait_for_timeout(300.0)
    spectrum = "page.charts.find(each => each.key === 'spectrum').panels[0]"
    assert page.evaluate(f"[{spectrum}.marks.length, {spectrum}.recorded.marks.length > 0]") == [0, True]
    changed = flexfmu.run(run.scene.replace({"payload.mass": mass}))
    # of the other joint than in the recording, which has the larger torque now
    expected = measure_run(changed, 0)
    assert [
        run.metrics["peak_torque_1"] > run.metrics["peak_torque_2"],
        expected["peak_torque_1"] < expected["peak_torque_2"],
    ] == [True, True]
    assert tile.inner_text() == f"{expected['peak_torque_2'].value:.4g} N·m"
    assert (
        f"its links bend by up to {display('peak_tip_deflection_2', expected['peak_tip_deflection_2'], 3)}"
        in page.locator(".verdict").inner_text()
    )
    # what rings, as the report of that run says
    (ringing,) = re.findall("mostly at ([0-9.]+ Hz)", changed.live().html.partition("</header>")[0])
    assert f", mostly at {ringing};" in page.locator(".verdict").inner_text()
    # figures have the digits that their errors allow, once these are known
    page.evaluate("location.hash = '#accuracy=3'")
    page.wait_for_timeout(1500.0)
    said = r"metrics within [0-9.]+ % \([A-Z][^()]+\) of a run with half the step"
    assert re.search(said, page.locator(".status").inner_text())
    (coarse,) = page.locator(".tile [data-metric=rms_acceleration_error]").all_inner_texts()
    sharp = measure_run(run, 0)["rms_acceleration_error"].value
    assert len(coarse.split()[0]) < 6
    assert float(coarse.split()[0]) == pytest.approx(sharp, rel=2e-3)
    page.evaluate(f"location.hash = '#payload.mass={mass}'")
    page.wait_for_timeout(500.0)
    # a step of the keyboard from where a slider begins, and back
    slider.fill("0")
    places = list[str]()
    for key in ("ArrowRight", "ArrowLeft", "ArrowLeft"):
        slider.press(key)
        places.append(slider.input_value())
    assert [float(each) for each in places] == pytest.approx([0.005, 0.0, -0.005], abs=1e-9)
    slider.fill("0.4")
    page.wait_for_timeout(500.0)
    assert page.locator(".lead.stale").count() == 1
    # the same state by the address, then back; on a phone
    address = page.url
    page.goto("about:blank")
    page.goto(address)
    page.locator("#live.ready").wait_for()
    page.wait_for_timeout(500.0)
    assert tile.inner_text() != before
    assert slider.get_attribute("aria-valuetext") == f"{mass:.4g} kg"
    # another state in the same tab, and one that can't be
    page.evaluate("location.hash = '#payload.mass=5'")
    page.wait_for_timeout(500.0)
    assert slider.get_attribute("aria-valuetext") == "5 kg"
    # a value that is typed, and a step to a round one; one beyond an end is the end, and is said
    field, status = page.get_by_role("spinbutton", name="payload.mass"), page.locator(".status")
    for typed, key, value, is_said in (
        ("4.123", "Enter", 4.123, False),
        ("4.123", "ArrowUp", 4.2, False),
        ("99", "Enter", 18.0, True),
    ):
        field.fill(typed)
        field.press(key)
        page.wait_for_timeout(500.0)
        assert (float(field.input_value()), page.url.partition("#")[2]) == (value, f"payload.mass={value:g}")
        assert ("There are values outside the sliders (payload.mass=99)." in status.inner_text()) == is_said
    # an end that has no short number, in the address with all digits or with four
    duration = page.get_by_role("slider", name="duration of the motion")
    duration.fill(duration.get_attribute("min"))
    page.wait_for_timeout(500.0)
    for address in (page.url, page.url.partition("#")[0] + "#payload.mass=18&duration=0.1433"):
        page.evaluate(f"location.href = '{path.as_uri()}#'")
        page.wait_for_timeout(300.0)
        page.evaluate(f"location.href = {address!r}")
        page.wait_for_timeout(500.0)
        assert "outside" not in status.inner_text()
        assert page.evaluate("[...page.live.state.values()]") == [18, pytest.approx(0.43 / 3.0, rel=1e-6)]
    page.evaluate("location.hash = '#payload.mass=-3&shaper=7'")
    page.wait_for_timeout(100.0)
    assert "outside the sliders (payload.mass=-3, shaper=7)" in page.locator(".status").inner_text()
    assert tile.inner_text() == before
    # an earlier state that is written into the address meanwhile doesn't undo it
    page.evaluate("location.hash = '#payload.mass=5'; history.replaceState(null, '', location.pathname)")
    page.wait_for_timeout(500.0)
    page.get_by_role("button", name="as recorded").click(timeout=5000.0)
    page.wait_for_timeout(300.0)
    assert tile.inner_text() == before
    assert page.locator(".lead.stale").count() == 0
    assert "with all bits of the recording" in page.locator(".status").inner_text()
    page.set_viewport_size({"width": 390, "height": 800})
    page.wait_for_timeout(100.0)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert {each.partition("#")[0] for each in problems} <= {f"file://{path}", "about:blank"}
    page.close()


def test_the_same_sliders_come_first_on_a_slow_machine(browser: Any, tmp_path: Path) -> None:
    """Their order is that of what they change, however long that takes."""
    path, found = flexfmu.run("barnard2012-6kg").live_report(tmp_path / "x.html"), list[Any]()
    for script in ("", "let n = 0; performance.now = () => (n += 3000);"):
        page = browser.new_page()
        page.add_init_script(script)
        page.goto(f"file://{path}")
        page.locator("#live.ready").wait_for()
        found.append(page.evaluate("page.live.sliders.map(each => [each.name, each.influence])"))
        page.close()
    assert found[0] == found[1]
    assert min(influence for _, influence in found[0]) > 0.0


def test_a_page_is_not_larger_than_its_limit(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the motion between knots it is small, and says what it lacks; figures are the same to what is shown."""
    run = flexfmu.run("barnard2012-6kg")
    whole = run.live_report(tmp_path / "whole.html").stat().st_size
    monkeypatch.setattr("flexfmu.cosim.exchange.live.LARGEST", whole - 10_000)
    path = run.live_report(tmp_path / "x.html")
    assert path.stat().st_size < 0.8 * whole
    page, problems = opened(browser, path)
    assert (
        "This page simulates within rounding of the run, because all of its bits would take more than 1 MB."
        in page.locator(".hero").inner_text()
    )
    assert "bits" not in page.locator(".status").inner_text()
    metrics = page.evaluate("page.live.usual.metrics")
    for name, metric in measure_run(run, 0).items():
        assert name not in metrics or metrics[name] == pytest.approx(metric.value, rel=1e-6), name
    assert problems == []
    page.context.close()


def test_runs_beyond_the_room_of_a_page_stay_as_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Side by side there are those that the page has room for; it says which it doesn't simulate."""
    scene = load_scene("barnard2012-6kg")
    found = flexfmu.compare(scene, scene.replace({"name": "soft", "effects.proximal_bending": 2}))
    whole = found.page(live=True)
    assert "simulate soft" not in whole
    limit = len(whole) - 10_000
    monkeypatch.setattr("flexfmu.cosim.exchange.live.LARGEST", limit)
    text = found.page(live=True)
    assert len(text.encode()) <= limit
    assert "This page can't simulate soft: the page would be larger than 1 MB." in unescape(text)


def opened(browser: Any, path: Path, scheme: str = "light") -> tuple[Any, list[str]]:
    """A page that is ready, and what it tells on the console, where axe finds nothing at either width."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe
    assert path.stat().st_size < LARGEST_PAGE
    page, problems = browser.new_context(color_scheme=scheme, bypass_csp=True).new_page(), list[str]()
    page.on("console", lambda message: problems.append(message.text))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(f"file://{path}")
    page.locator("#live.ready").wait_for()
    for width in (390, 1400):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100.0)
        assert page.evaluate("document.documentElement.scrollWidth") == width
        found = axe().run(page).response["violations"]
        assert [(each["id"], each["nodes"][0]["html"][:200]) for each in found] == []
    return page, problems


def number(text: str) -> float:
    """The first number of a text."""
    return float(text.split()[0].replace("−", "-"))


def test_a_shaper_is_switched_on(browser: Any, tmp_path: Path) -> None:
    """The run with the usual shaper, which the page has beside the scene's own; as a command and as a scene that gives the same."""
    path = flexfmu.run("barnard2012-6kg").live_report(tmp_path / "x.html")
    page, problems = opened(browser, path)
    page.get_by_label("input shaper").select_option("ZV shaper")
    page.get_by_role("slider", name="payload.mass").fill("-0.4")
    page.wait_for_timeout(800.0)
    page.get_by_role("button", name="copy as command").click()
    assert "--set 'shaper=[{ kind = \"zv\" }]'" in page.locator(".command").inner_text()
    assert page.get_by_role("slider", name="duration of the motion").is_disabled()
    remarks = page.locator(".remarks").inner_text()
    assert "The duration stays as recorded: an input shaper acts on the motion." in remarks
    assert "stay as they were designed, for the recorded robot" in remarks
    page.get_by_role("button", name="copy as scene").click()
    (tmp_path / "scene.toml").write_text(page.locator(".command").inner_text())
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.shaper[0].kind == "zv"
    # the shaper doesn't know the payload
    shaped = PreparedScene(load_scene("barnard2012-6kg").replace({"shaper": [{"kind": "zv"}]}))
    mass = scene.imperfection[0].parameters["payload.mass"]
    expected = measure_run(shaped.run({"payload.mass": mass}), 0)
    assert measure_run(flexfmu.run(scene), 0)["peak_torque_1"].value == pytest.approx(expected["peak_torque_1"].value)
    for name in ("peak_torque", "residual_vibration_amplitude"):
        shown = page.locator(f".tile [data-metric={name}]").inner_text()
        values = [expected[each].value or 0.0 for each in OF_BOTH.get(name, (name,))]
        assert number(shown) == float(f"{definition(name).displayed(max(values)):.4g}")
    assert problems == []
    page.context.close()


def test_motors_stay_as_recorded(browser: Any, tmp_path: Path) -> None:
    """Where a slider moved, tables and charts that the page doesn't compute are marked; what it computes, and its names, aren't. The verdict's
    motor is that of the simulated run."""
    motor = {"continuous_torque": 3.0, "peak_torque": 4.0, "maximum_speed": 400.0}
    motor |= {"gear_ratio": 20.0, "gear_efficiency": 0.9, "rotor_inertia": 1e-4}
    scene = load_scene("barnard2012-6kg").replace({"motor": motor})
    page, problems = opened(browser, flexfmu.run(scene).live_report(tmp_path / "x.html"))
    motors = page.locator("details", has=page.locator("summary", has_text="Motors")).locator("td")
    caption = page.locator("figure", has=page.locator("h3", has_text="Torque over speed, motor 1")).locator(".caption")
    metrics = page.locator("tr", has=page.locator("[data-metric]")).locator("td")
    stale, seen = "cells => cells.map(each => each.classList.contains('stale'))", set[bool]()
    for place, is_moved in (("-0.4", True), ("0", False)):
        page.get_by_role("slider", name="payload.mass").fill(place)
        page.wait_for_timeout(800.0)
        for cells in (motors, caption):
            assert {*cells.evaluate_all(stale)} == {is_moved}
        assert {*metrics.evaluate_all(stale)} == {False}
        mass = float(page.url.partition("#payload.mass=")[2] or 6.0)
        loads = motor_loads(flexfmu.run(scene.replace({"payload.mass": mass})))
        use, name, joint = max((limit.use, limit.name, load.joint) for load in loads for limit in load.margins)
        said = f"; motor {joint} needs {100.0 * use:.3g} % of its {name}."
        assert page.locator(".verdict").inner_text().endswith(said)
        assert (said[:-1] in page.locator(".verdict .over").all_inner_texts()) == (use > 1.0)
        seen.add(use > 1.0)
    assert seen == {True, False}
    assert problems == []
    page.context.close()


def test_runs_side_by_side_have_common_sliders(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A payload of 0.64 times its own in two scenes of three; results that were read stay as recorded, and the page says so."""
    scene = load_scene("barnard2012-6kg")
    light, old = scene.replace({"name": "light", "payload.mass": 4.0}), tmp_path / "old"
    old.mkdir()
    flexfmu.run(scene).write(old / "results.csv")
    flexfmu.compare(scene, light, old).write(tmp_path, live=True)
    page, problems = opened(browser, tmp_path / "comparison.html", "dark")
    assert "This page can't simulate old: only its results are known." in page.locator(".hero").inner_text()
    slider = page.get_by_role("slider", name="payload.mass")
    slider.fill("-0.4")
    page.wait_for_timeout(500.0)
    ratio = float(page.url.partition("#payload.mass=")[2]) / 6.0
    cells = page.locator("td [data-metric=peak_torque_1]").all_inner_texts()
    for cell, each in zip(cells, (scene, light), strict=False):
        changed = each.replace({"payload.mass": ratio * each.payload.mass})
        assert number(cell) == pytest.approx(measure_run(flexfmu.run(changed), 0)["peak_torque_1"].value, rel=1e-4)
    # differences have their sign where what they refer to is negative, too
    rows = [each.locator("[data-metric]").all_inner_texts() for each in page.locator("tr:has([data-metric])").all()]
    pairs = [(number(first), second) for first, second, *_ in rows if first != "–" and number(first)]
    assert min(first for first, _ in pairs) < 0.0
    for first, second in pairs:
        difference = 100.0 * (number(second) - first) / abs(first)
        assert number(second.partition("(")[2]) == pytest.approx(difference, rel=1e-2, abs=0.1), (first, second)
    # lines go from point to point, not by whole pixels
    page.evaluate("page.charts.find(each => each.key === 'compared-0').body.scrollIntoView()")
    page.wait_for_timeout(300.0)
    upright = """(() => { let before = NaN, found = 0; const { lineTo } = Path2D.prototype;
      Path2D.prototype.lineTo = function (x, y) { found += x === before; before = x; lineTo.call(this, x, y); };
      page.charts.find(each => each.key === 'compared-0').redraw();
      return new Promise(done => setTimeout(() => { Path2D.prototype.lineTo = lineTo; done([found, before]); }, 200)); })()"""
    found, last = page.evaluate(upright)
    assert (found, last > 0.0) == (0, True)
    # what the page doesn't compute is as recorded
    cost = page.locator("tr", has=page.locator("th", has_text="Processor time")).locator("td.value")
    assert cost.count() > 0
    assert cost.evaluate_all("cells => cells.every(each => each.classList.contains('stale'))")
    # copies have each scene's own value
    page.get_by_role("button", name="copy as command").click()
    *runs, compared = page.locator(".command").inner_text().split(" &&\n")
    folders = [shlex.split(each)[-1] for each in runs]
    assert shlex.split(compared) == ["flexfmu", "compare", *folders]
    assert [each.partition("-payload.mass=")[0] for each in folders] == ["results/barnard2012-6kg", "results/light"]
    monkeypatch.chdir(tmp_path)
    for cell, line in zip(cells, runs, strict=False):
        assert run_command(*shlex.split(line)[1:], "--no-report", "--no-verify").exit_code == 0
        summary = json.loads((Path(shlex.split(line)[-1]) / "summary.json").read_text())
        assert number(cell) == pytest.approx(summary["metrics"]["peak_torque_1"], rel=1e-4)
    page.get_by_role("button", name="copy light as scene").click()
    (tmp_path / "light.toml").write_text(page.locator(".command").inner_text())
    copied = load_scene(tmp_path / "light.toml")
    assert (copied.name, copied.payload.mass) == ("light", pytest.approx(4.0 * ratio, rel=1e-5))
    assert problems == []
    page.context.close()


def test_what_simulates_stands_beside_what_does_not(browser: Any, tmp_path: Path) -> None:
    """A first run that can't be simulated has other signals than the second, whose differences from it are known; the robot in motion is the
    first one's. What is rounding is nothing."""
    cycles = {"trajectory.way_back": "same-path", "trajectory.cycles": 2}
    first = load_scene("barnard2012-6kg").replace({"name": "cycles", **cycles})
    rigid = dict.fromkeys(("effects.proximal_bending", "effects.distal_axial"), 0)
    second = load_scene("barnard2012-6kg").replace(
        {"name": "rigid", "payload.mass": 4.0, "cosimulation.step": 4e-4, **rigid}
    )
    flexfmu.compare(first, second).write(tmp_path, live=True)
    page, problems = opened(browser, tmp_path / "comparison.html")
    assert "This page can't simulate cycles: its motion repeats." in page.locator(".hero").inner_text()
    page.get_by_role("slider", name="payload.mass").fill("0.5")
    page.wait_for_timeout(800.0)
    assert page.locator(".alarm").inner_text() == ""
    one, other = (number(each) for each in page.locator("td [data-metric=peak_torque_1]").all_inner_texts())
    difference = page.locator("td [data-metric=peak_torque_1]").nth(1).inner_text().partition("(")[2]
    assert number(difference) == pytest.approx(100.0 * (other / one - 1.0), rel=1e-2)
    assert page.locator("td [data-metric=residual_vibration_amplitude]").nth(1).inner_text().split("(")[0] == "0 mm "
    assert page.locator("figure", has_text="Scene").locator(".caption.stale").count() == 1
    assert problems == []
    page.context.close()


def test_a_sweep_simulates_the_point_that_is_picked(browser: Any, tmp_path: Path) -> None:
    """Its case's own values, and those between cases; what no slider changes is said."""
    scene = load_scene("barnard2012-6kg")
    keys = {
        "payload.mass": [2.0, 4.0, 5.5],
        "trajectory.duration": [0.4, 0.43],
        "trajectory.dwell": [0.2, 0.25],
        "trajectory.profile": ["poly7"],
    }
    result = flexfmu.sweep(scene, keys, processes=1)
    (tmp_path / "sweep.html").write_text(result.page(live=True))
    page, problems = opened(browser, tmp_path / "sweep.html")
    assert (
        "other values of trajectory.dwell, trajectory.profile, which stay as in the scene"
        in page.locator(".hero").inner_text()
    )
    figure = page.locator("figure", has=page.locator("h3", has_text="Peak torque, joint 1"))
    figure.scroll_into_view_if_needed()
    page.wait_for_timeout(500.0)
    # points with other values of what has no slider
    page.evaluate("page.pick([[{ 'payload.mass': 2, 'trajectory.dwell': 0.2 }]])")
    said = "This point isn't simulated: trajectory.dwell has no slider, and is 0.25 in the page."
    assert page.locator(".status").inner_text() == said
    assert "#" not in page.url
    # beside the chart that was clicked, too
    page.evaluate("""() => { const [panel] = page.charts.find(each => each.key === 'sweep-peak_torque_1').panels;
      panel.chosen = [[{ 'payload.mass': 2, 'trajectory.dwell': 0.2 }]];
      for (const each of ["pointerdown", "pointerup"]) panel.plot.over.dispatchEvent(new MouseEvent(each)); }""")
    assert figure.locator(".said").inner_text() == said
    # the slider has the scene's own value within
    assert page.evaluate("page.live.sliders.find(({ name }) => name === 'payload.mass').high") == 6.0
    page.evaluate("page.pick([[{ 'payload.mass': 2, 'trajectory.dwell': 0.25 }, 'trajectory.profile=poly5']])")
    assert "trajectory.profile has no slider, and is poly7 in the page" in page.locator(".status").inner_text()
    # the first point of the line with the scene's own, which lies on that of the other dwell
    place = """() => { const { plot, curves } = page.charts.find(each => each.key === 'sweep-peak_torque_1').panels[0];
      const { x, y } = curves.find(each => each.label.includes('duration=0.4, trajectory.dwell=0.25'));
      return [plot.valToPos(x[0], 'x'), plot.valToPos(y[0], 'y')]; }"""
    left, top = page.evaluate(place)
    figure.locator(".u-over").hover(position={"x": left, "y": top})
    assert figure.locator(".said").inner_text().count("duration") == 1
    figure.locator(".u-over").click(position={"x": left, "y": top})
    page.wait_for_timeout(800.0)
    assert page.url.endswith("#payload.mass=2&duration=0.4")
    tile = page.locator(".tile [data-metric=peak_torque_1]")
    assert tile.inner_text() == f"{result[0]['peak_torque_1']:.4g} N·m"
    now = "page.charts.find(each => each.key === 'sweep-peak_torque_1').panels[0].curves.at(-1)"
    assert page.evaluate(f"[{now}.x[0], {now}.y[0]]") == pytest.approx([2.0, result[0]["peak_torque_1"]], rel=1e-6)
    page.get_by_role("slider", name="payload.mass").fill("5")
    page.wait_for_timeout(500.0)
    expected = measure_run(flexfmu.run(scene.replace({"payload.mass": 5.0, "trajectory.duration": 0.4})), 0)
    assert tile.inner_text() == f"{expected['peak_torque_1'].value:.4g} N·m"
    assert problems == []
    page.context.close()


class Firefox:
    """Debian's Firefox without a window, by the protocol that it has itself: Marionette, JSON behind its length (playwright needs its own build)."""

    def __init__(self, program: str, profile: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        (profile / "user.js").write_text(f'user_pref("marionette.port", {port});\n')
        command = [program, "--headless", "--marionette", "--no-remote", "--profile", str(profile)]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for _ in range(600):
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), 60.0)
                break
            except OSError:
                time.sleep(0.1)
        self.file, self.count = self.socket.makefile("rb"), 0
        self.receive()
        self.send("WebDriver:NewSession")

    def receive(self) -> Any:
        """The next message."""
        size = b""
        while (digit := self.file.read(1)) != b":":
            assert digit
            size += digit
        return json.loads(self.file.read(int(size)))

    def send(self, name: str, **arguments: Any) -> Any:
        """What a command answers."""
        self.count += 1
        text = json.dumps([0, self.count, name, arguments]).encode()
        self.socket.sendall(b"%d:%s" % (len(text), text))
        _, _, error, found = self.receive()
        assert error is None, error
        return found

    def evaluate(self, expression: str) -> Any:
        """The value of a promise of the page, whose policy allows scripts in it alone."""
        script = """const [text, done] = arguments, script = document.createElement("script");
        addEventListener("told", () => done(document.body.dataset.told), { once: true });
        script.textContent = `(async () => (${text}))().catch(String).then((found) => {
          document.body.dataset.told = JSON.stringify(found ?? null); dispatchEvent(new Event("told")); })`;
        document.body.append(script);"""
        found = self.send("WebDriver:ExecuteAsyncScript", script=script, args=[expression], scriptTimeout=60000)
        return json.loads(found["value"])


@pytest.fixture
def firefox(tmp_path: Path) -> Iterator[Firefox]:
    """One for a test."""
    program = shutil.which("firefox-esr") or shutil.which("firefox")
    if program is None:
        pytest.skip("needs firefox")
    (tmp_path / "profile").mkdir()
    found = Firefox(program, tmp_path / "profile")
    yield found
    found.send("Marionette:Quit")
    found.file.close()
    found.socket.close()
    found.process.wait(30.0)


def test_firefox_simulates_with_the_same_bits(firefox: Firefox, tmp_path: Path) -> None:
    """From file://: the recording's bits, a figure that follows a slider, no error."""
    run = flexfmu.run("barnard2012-6kg")
    firefox.send("WebDriver:Navigate", url=f"file://{run.live_report(tmp_path / 'x.html')}")
    wait = "new Promise(done => { const look = () => (document.querySelector('#live.ready') ? done() : setTimeout(look, 50)); look(); })"
    firefox.evaluate(f"{wait}.then(() => {{ onerror = (message) => (document.body.dataset.problem = message); }})")
    shown = firefox.evaluate("Array.from(page.live.usual.signal('joint1.torque', 1))")
    np.testing.assert_array_equal(shown, run.recording["joint1.torque"].first)
    moved = """(() => { const slider = page.live.sliders.find(({ name }) => name === "payload.mass");
      slider.input.value = -0.4; slider.input.dispatchEvent(new Event("input"));
      return new Promise(done => setTimeout(() => done([page.live.state.get(slider), document.querySelector(".tile [data-metric=peak_torque]").textContent, document.body.dataset.problem ?? ""]), 1500)); })()"""
    mass, tile, problem = firefox.evaluate(moved)
    expected = measure_run(flexfmu.run(run.scene.replace({"payload.mass": mass})), 0)["peak_torque_1"].value
    assert tile == f"{expected:.4g} N·m"
    assert problem == ""


def test_a_notebook_s_page_is_accessible(browser: Any, tmp_path: Path) -> None:
    """It simulates within a frame, without errors; in the page itself axe finds nothing."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe
    shown = flexfmu.run("barnard2012-6kg").live()
    (tmp_path / "x.html").write_text(shown.html)
    (tmp_path / "notebook.html").write_text(f"<!DOCTYPE html><body>{shown._repr_html_()}</body>")
    context = browser.new_context(color_scheme="dark", bypass_csp=True)
    page, problems = context.new_page(), list[str]()
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(f"file://{tmp_path / 'notebook.html'}")
    frame = page.frame_locator("iframe")
    frame.locator("#live.ready").wait_for()
    tile = frame.locator(".tile [data-metric=peak_torque]")
    before = tile.inner_text()
    frame.get_by_role("slider", name="payload.mass").fill("-0.4")
    page.wait_for_timeout(800.0)
    assert tile.inner_text() != before
    page.goto(f"file://{tmp_path / 'x.html'}")
    page.locator("#live.ready").wait_for()
    found = axe().run(page).response["violations"]
    assert [(each["id"], each["nodes"][0]["html"][:200]) for each in found] == []
    assert problems == []
    context.close()


def test_what_a_slider_breaks_is_said_first(browser: Any, tmp_path: Path) -> None:
    """The verdict has the figures of what was simulated; a loop that a gain makes unstable is an alert and the first word, one that
    fails has no figures; what isn't simulated is marked, and no recorded error stands beside another value."""
    pd = {"kind": "pd", "proportional": 5e3, "derivative": 60.0, "sample_time": 1e-3}
    changes = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "effects.proximal_bending": 1}
    scene = load_scene("barnard2012-6kg").replace({**changes, "controller": [pd]})
    path = flexfmu.run(scene).live_report(tmp_path / "x.html")
    page, problems = opened(browser, path)
    verdict, alarm, errors = (page.locator(each) for each in (".verdict", ".alarm", "td [data-shown*=isError]"))
    before = verdict.inner_text()
    assert not alarm.is_visible()
    assert any(each.strip() for each in errors.all_inner_texts())

    def moved(gain: float) -> Any:
        page.evaluate(f"page.pick([[{{'controller[0].derivative': {gain}}}]])")
        page.wait_for_timeout(1500.0)
        changed = scene.replace({"pd.kd": gain})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return flexfmu.run(changed)

    run = moved(90.0)
    value = definition("peak_position_error").displayed(measure_run(run, 0)["peak_position_error"].value or 0.0)
    assert f"is up to {value:.3g} mm off its planned motion" in verdict.inner_text()
    assert verdict.inner_text() != before
    assert not alarm.is_visible()
    assert page.locator(".recorded").is_visible()
    values = dict.fromkeys(("peak_torque_1", "rms_acceleration_error", "residual_vibration_amplitude"))
    for name in values:
        value, error = page.locator(f"td [data-metric={name}]").all()
        assert "stale" not in (value.get_attribute("class") or "")
        assert error.inner_text() == ""
    assert page.locator("td .stale").count() == 0
    # further and further
    unstable = 0
    for gain in (300.0, 600.0, 1200.0, 2400.0):
        run = moved(gain)
        if run.completed and not run.health.unstable_loop:
            continue
        unstable += 1
        assert alarm.is_visible()
        assert alarm.get_attribute("role") == "alert"
        assert verdict.inner_text().startswith("Unstable.")
        assert verdict.locator(".over").first.inner_text().strip() == "Unstable."
        if not run.completed:
            assert set(page.locator(".tile [data-metric]").all_inner_texts()) == {"–"}
    assert unstable
    assert not run.completed
    page.get_by_role("button", name="as recorded").click()
    page.wait_for_timeout(300.0)
    assert verdict.inner_text() == before
    assert not alarm.is_visible()
    assert problems == []
    page.context.close()
