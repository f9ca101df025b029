"""Parts of the loop from Python: `flexfmu.control` and its like are the scene file's sections, and objects take part everywhere."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from python_slave import PythonSlave

import flexfmu

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "generators"))
import part_stubs  # noqa: E402

FAMILIES = (flexfmu.control, flexfmu.disturbances, flexfmu.filters, flexfmu.imperfections, flexfmu.shapers)
PARTS = [
    pytest.param(family, getattr(family, name), id=f"{family.__name__}.{name}")
    for family in FAMILIES
    for name in family.__all__
    if getattr(family, name).__module__ == family.__name__
]
"""Every function that describes a part."""

PD = {"proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
ROBOT = flexfmu.load_scene("barnard2012-0.1kg").replace(
    {"effects.motor_inertia": 0.1, "effects.proximal_bending": 1, "effects.distal_axial": 0, "trajectory.dwell": 0.0}
)


def example(function: Callable[..., Any]) -> str:
    """The call in a docstring."""
    (line,) = [each for each in (function.__doc__ or "").splitlines() if each.startswith("    ``flexfmu.")]
    return line.strip(" `")


def torques(run: Any) -> np.ndarray:
    """Of the first motor [N.m], of a run that reached its end."""
    assert run.completed, run.message
    return run.recording["joint1.torque"].values  # type: ignore[no-any-return]


@pytest.mark.parametrize(("family", "function"), PARTS)
def test_example_of_each_part_is_a_table_of_the_scene_file(family: ModuleType, function: Callable[..., Any]) -> None:
    """The call of the docstring works, and a scene takes what it returns under the family's key."""
    section = eval(example(function), {"flexfmu": flexfmu})
    key = {"control": "controller"}.get(family.__name__.rpartition(".")[2], family.__name__.rpartition(".")[2][:-1])
    scene = ROBOT.replace({"cosimulation.drive": "torque", "payload.mass": 1.0, key: [section]})
    assert getattr(scene, key) == (section,)
    # the same from the section's keys alone, as a file has them
    assert scene.replace({key: [section.model_dump(exclude_none=True)]}) == scene


@pytest.mark.parametrize(("family", "function"), PARTS)
def test_signature_of_each_part_is_that_of_its_section(family: ModuleType, function: Callable[..., Any]) -> None:
    """All keys but the kind are arguments, described in the docstring; those without a default are the required ones."""
    signature = inspect.signature(function)
    section = signature.return_annotation
    assert set(signature.parameters) == set(section.model_fields) - {"kind"}
    text = inspect.getdoc(function) or ""
    assert all(f"    {name}: " in text for name in signature.parameters)
    required = {name for name, each in signature.parameters.items() if each.default is each.empty}
    assert required == {name for name, field in section.model_fields.items() if field.is_required()} - {"kind"}


@pytest.mark.parametrize("path", part_stubs.stubs())
def test_stubs_are_up_to_date(path: Path) -> None:
    """Type checkers see the functions as they are: `python generators/part_stubs.py` writes nothing new."""
    assert path.read_text(encoding="utf-8") == part_stubs.stubs()[path]


@given(st.one_of(st.none(), st.text(), st.booleans(), st.floats(), st.lists(st.floats(), max_size=3), st.binary()))
def test_wrong_values_are_scene_errors(value: Any) -> None:
    """Any value of a gain gives a part with it, or one line that names the key and the function."""
    try:
        section = flexfmu.control.pd(proportional=value, derivative=1.0, sample_time=1e-3)
    except flexfmu.SceneError as error:
        message = str(error)
    else:
        message = "`proportional` flexfmu.control.pd"
        assert np.all(np.isfinite(section.proportional))
        # arrays and numbers of numpy are taken as lists and numbers
        assert section == flexfmu.control.pd(
            proportional=np.array(value), derivative=np.float64(1.0), sample_time=np.float64(1e-3)
        )
        assert np.all(np.broadcast_to(value, 2) == section.proportional)
    assert "\n" not in message
    assert "`proportional" in message
    assert "flexfmu.control.pd" in message


def test_three_ways_to_the_same_controller() -> None:
    """As a part, a table, and the scene file's own section, a run is the same to the bit; torques drive the robot by themselves."""
    assert ROBOT.cosimulation.drive == "motion"
    own = ROBOT.replace({"cosimulation.drive": "torque", "controller": [{"kind": "pd", **PD}]})
    expected = torques(flexfmu.run(own))
    # None leaves a key out
    for controller in (flexfmu.control.pd(**PD, offset=None), {"kind": "pd", **PD}):
        assert np.array_equal(torques(flexfmu.run(ROBOT, controllers=[controller])), expected)


@flexfmu.controller(sample_time=1e-3)
def springs(reference: Any, measurement: Any, *, stiffness: float = 1e4, damping: float = 100.0) -> Any:
    """The same law as `PD`."""
    error = reference - measurement
    return stiffness * error[:2] + damping * error[2:]


def test_own_function_takes_part_everywhere() -> None:
    """Runs, margins and sweeps of a function are those of the built-in controller with the same law."""
    built_in = {"controllers": [flexfmu.control.pd(**PD)]}
    for call in (
        lambda **parts: torques(flexfmu.run(ROBOT, **parts)),
        lambda **parts: flexfmu.margins(ROBOT, poses=1, **parts).worst.delay_margin,
        lambda **parts: [each["peak_torque_1"] for each in flexfmu.sweep(ROBOT, {"payload.mass": [0.1, 1.0]}, **parts)],
        lambda **parts: flexfmu.compare(ROBOT, **parts).runs[0].metrics["peak_tracking_error_1"].value,
    ):
        np.testing.assert_allclose(call(controllers=[springs]), call(**built_in), rtol=1e-9)


def test_connect_and_python_control() -> None:
    """A system with names of its own, connected by name, is the controller that its matrices say."""
    gains = np.hstack([1e4 * np.eye(2), -1e4 * np.eye(2)])
    law = control.StateSpace([], [], [], gains, True, inputs=["r1", "r2", "q1", "q2"], outputs=["t1", "t2"])
    law.dt = 1e-3
    wires = {f"controller.q{j}": f"plant.joint{j}.position" for j in (1, 2)}
    wires |= {f"controller.r{j}": f"trajectory.joint{j}.reference.position" for j in (1, 2)}
    wires |= {f"plant.joint{j}.torque": f"controller.t{j}" for j in (1, 2)}
    with pytest.warns(UserWarning, match="unstable"):  # a spring between reference and angle doesn't damp
        torque = torques(flexfmu.run(ROBOT, controllers=[law], connect=wires))
    spring = flexfmu.control.pd(proportional=1e4, derivative=0.0, sample_time=1e-3)
    with pytest.warns(UserWarning, match="unstable"):
        expected = torques(flexfmu.run(ROBOT, controllers=[spring]))
    np.testing.assert_allclose(torque, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"controllers": flexfmu.control.pd(**PD)}, r"controllers is a list, .* write controllers=\[...\]"),
        ({"filters": [springs]}, "filters are made by flexfmu.filters, got FunctionController"),
        ({"connect": {"a.b": "c.d"}}, "connect needs a controller"),
        ({"controllers": [3]}, r"`controller\[0\]` must be a table like"),
        ({"controllers": ["none.fmu"]}, "can't read the FMU none.fmu"),
        ({"imperfections": [flexfmu.control.pd(**PD)]}, r"'pd' is one of the controllers, .* controllers=\[...\]"),
        ({"controllers": [springs, springs]}, "are both 'springs': give each a name of its own"),
        ({"shapers": [flexfmu.shapers.zvd()], "connect": "a=b"}, "connect gives the source of each input, got 'a=b'"),
        (
            {"imperfections": [flexfmu.imperfections.delay(time=2)]},
            r"a delay of 2 s is longer than the run, .* 0.002 for 2 ms",
        ),
        (
            {"imperfections": [flexfmu.imperfections.delay(time=0.0, longest=2)]},
            r"a delay of 2 s is longer than the run, .* give its `longest` in s",
        ),
        (
            {"disturbances": [flexfmu.disturbances.step(signal="force.x", amplitude=1.0)]},
            "on a robot that torques drive",
        ),
        ({"tolerance": float("nan")}, "tolerance must be a finite number above 0, got nan"),
        ({"communication_step": "1e-3"}, "communication_step must be a finite number above 0, got '1e-3'"),
        ({"record": "joint1.torque"}, r"record is a list, got str: write record=\[...\]"),
        ({"progress": 3}, "progress is a function of the simulated fraction, got 3"),
        ({"controllers": [{"kind": "object", "object": 1}]}, "objects are given in Python"),
        ({"controler": []}, "run has no argument 'controler'; did you mean 'controllers'"),
    ],
)
def test_wrong_parts(arguments: dict[str, Any], message: str) -> None:
    """Each is refused in one line that says what to write."""
    with pytest.raises((flexfmu.Error, TypeError), match=message) as caught:
        flexfmu.run(ROBOT, **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: flexfmu.shapers.zvd(kind="zv"), "the function's name is the kind, got kind='zv'"),  # type: ignore[call-arg]
        (lambda: flexfmu.margins(ROBOT, shaper=[]), "unexpected argument 'shaper'"),  # type: ignore[call-arg]
        (lambda: flexfmu.sweep(ROBOT, {"springs.arguments.stifness": [1.0]}, controllers=[springs]), "stifness"),
        (lambda: flexfmu.reference_motion("barnard"), "no scene file 'barnard': give a path, or one of the shipped"),
        (lambda: flexfmu.run(6.0), r"expected a Scene, .* got float: 6\.0"),  # type: ignore[arg-type]
        (lambda: flexfmu.simulat, r"no attribute 'simulat'; it has .*Scene, .* run"),  # type: ignore[attr-defined]
        (lambda: flexfmu.modes(ROBOT, 4), "number of poses must be odd"),
    ],
)
def test_wrong_calls(call: Callable[[], Any], message: str) -> None:
    """What doesn't exist is told at once, before anything is simulated, with what there is."""
    with pytest.raises((flexfmu.Error, TypeError, AttributeError), match=message):
        call()


def test_own_parameters_are_keys() -> None:
    """Parameters of a function are swept like those of a built-in controller, and give the same figures."""
    metrics = ["peak_tracking_error_1"]
    own = flexfmu.sweep(ROBOT, {"springs.arguments.stiffness": [5e3, 2e4]}, controllers=[springs], metrics=metrics)
    built_in = flexfmu.sweep(
        ROBOT, {"pd.proportional": [5e3, 2e4]}, controllers=[flexfmu.control.pd(**PD)], metrics=metrics
    )
    for one, other in zip(own, built_in, strict=True):
        np.testing.assert_allclose(one["peak_tracking_error_1"], other["peak_tracking_error_1"], rtol=1e-9)


def test_an_interrupted_run_ends_a_script(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C is raised again in a script; in an interactive session the run until then is given, with a warning."""

    def interrupt(fraction: float) -> None:
        if fraction > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        flexfmu.run(ROBOT, progress=interrupt)
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    with pytest.warns(flexfmu.RunWarning, match="interrupted"):
        run = flexfmu.run(ROBOT, progress=interrupt)
    assert 0.0 < run.recording.time[-1] < run.plan.duration


def test_a_sweep_notices_changed_files(tmp_path: Path) -> None:
    """A file that changed between two calls: the results in the folder belong to the old one."""
    file = tmp_path / "force.csv"
    file.write_text("time,force\n0,0\n1,10\n", encoding="utf-8")
    changes = {"payload.mass": [0.1]}
    arguments: dict[str, Any] = {"metrics": ["peak_torque_1"], "out": tmp_path / "out"}
    push = flexfmu.disturbances.csv(signal="force.x", file=file)
    loop = {"controllers": [flexfmu.control.pd(**PD)], "disturbances": [push]}
    first = flexfmu.sweep(ROBOT, changes, **arguments, **loop)
    assert list(flexfmu.sweep(ROBOT, changes, **arguments, **loop)) == list(first)
    file.write_text("time,force\n0,0\n1,1000\n", encoding="utf-8")
    with pytest.raises(flexfmu.InputError, match="files"):
        flexfmu.sweep(ROBOT, changes, **arguments, **loop)


def test_old_name_of_the_reference_motion() -> None:
    """`flexfmu.plan` goes on working, with a word about its new name."""
    with pytest.warns(DeprecationWarning, match="flexfmu.reference_motion"):
        assert flexfmu.plan is flexfmu.reference_motion  # type: ignore[attr-defined]


class Step(PythonSlave):
    """y = 1."""

    name = "step"
    variables = (flexfmu.SlaveVariable("y", "output", "1", 1.0),)


def test_systems_without_a_scene() -> None:
    """A step through a lag sampled by zero-order hold: closed form at every instant."""
    share = np.exp(-0.1)
    lag = control.StateSpace([[share]], [[1.0 - share]], [[1.0]], [[0.0]], 1e-2, inputs=["u"], outputs=["y"])
    found = flexfmu.simulate([Step(), flexfmu.slave(lag, "lag")], {"lag.u": "step.y"}, stop_time=0.5, step=1e-2)
    assert found.outcome.name == "COMPLETED", found.message
    # after each sample, where the recording has both sides
    time, values = found.recording.time, found.recording["lag.y"].values
    after = np.append(np.diff(time) > 0.0, True)
    np.testing.assert_allclose(values[after], 1.0 - np.exp(-time[after] / 0.1), atol=1e-12)
    assert after.sum() == 51
