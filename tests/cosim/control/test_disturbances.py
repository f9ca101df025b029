"""Disturbances: closed forms sample by sample, and balances of energy and momentum of a rigid robot that they act on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import band_noise, sampled, sine, table

from flexfmu.cosim.control.disturbances import steps
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.experiment.scene_build import depends_on, scene_key
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.fmu_build.regular_sampling import regular
from flexfmu.model.kinematics import load_mass_matrix
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock

H = 1e-3
TIGHT: Any = {"rtol": 1e-12, "atol": 1e-12}


def samples(block: SymbolicBlock, count: int) -> tuple[Any, Any]:
    """Instants (count,) and outputs (count,) of a block's samples."""
    return block.offset + block.sample_time * np.arange(count), sampled(block, np.empty((count, 0)))[:, 0]


@pytest.mark.parametrize(
    "instants", [(0.0,), (0.1,), (0.1003, 0.151), (0.0, 0.25), (0.02, 0.3), (0.1, 0.13, 0.2, 0.25)]
)
def test_steps_change_at_their_instants(instants: tuple[float, ...]) -> None:
    """Zero before the first instant; each instant is a sample, at which the value changes; so in an FMU with its sample time."""
    values = [float(1 + k) for k in range(len(instants))]
    block = steps("force.x", dict(zip(instants, values, strict=True)), "steps")
    assert set(block.instants) == {0.0, *instants}
    times, found = samples(regular(block), 2000)
    for at in instants:
        assert abs(times - at).min() < 1e-12
    wanted = np.concatenate([[0.0], values])[np.searchsorted(np.array(instants) - 1e-9, times, "right")]
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(("start", "duration"), [(0.0, None), (0.0103, 0.05)])
def test_sine_has_its_closed_form(start: float, duration: float | None) -> None:
    """A sin(2 pi f (t - start) + phase) at each sample between start and end, zero elsewhere."""
    block = sine(
        signal="force.y", amplitude=3.0, frequency=37.0, phase=0.4, sample_time=H, start=start, duration=duration
    )
    times, found = samples(block, 120)
    acts = (times > start - 1e-9) & (times < start + (duration or 9.0) - 1e-9)
    wanted = np.where(acts, 3.0 * np.sin(2.0 * np.pi * 37.0 * (times - start) + 0.4), 0.0)
    np.testing.assert_allclose(found, wanted, **TIGHT)
    assert acts.sum() == (120 if duration is None else 50)


@pytest.mark.parametrize("other", [None, {"kind": "pulse", "start": 0.02, "duration": 0.05, "amplitude": 7.0}, "sine"])
def test_a_short_pulse_is_sampled_where_it_changes(other: Any) -> None:
    """A pulse of 1 µs, of 1/3 µs, and 1 ms of the same impulse give the same velocity, for two communication points each,
    whatever else acts on the signal."""
    wave = {"kind": "sine", "amplitude": 5.0, "frequency": 10.0, "duration": 0.05, "sample_time": H}
    others = [] if other is None else [{**(wave if other == "sine" else other), "signal": "force.x"}]
    ends = []
    for duration, start in ((1e-3, 0.1), (1e-6, 0.1), (1e-6 / 3.0, 0.1000123456)):
        pulse = {
            "kind": "pulse",
            "signal": "force.x",
            "amplitude": 0.3 / duration,
            "start": start,
            "duration": duration,
        }
        changes = {**RIGID, "cosimulation.step": 2e-3, "disturbance": [pulse, *others]}
        run = run_scene(load_scene("barnard2012-6kg").replace(changes))
        assert run.completed, run.message
        assert run.recording.time.size < 420
        assert run.recording["force.x"].values[-1] == pytest.approx(0.0, abs=1e-12)
        ends.append(run.recording["end_effector.velocity.x"].values[-1])
    assert abs(ends[0]) > 0.01
    np.testing.assert_allclose(ends, ends[0], rtol=1e-2)


def test_noise_is_limited_to_its_band() -> None:
    """Over a period of 2 n / width the spectrum has n lines of equal power within the band, and nothing else."""
    n, low, high = 20, 10.0, 50.0
    period = round(2 * n / (high - low) / H)
    block = band_noise(2.5, (low, high), n, 7, signal="force.x", sample_time=H)
    _, found = samples(block, 2 * period)
    np.testing.assert_allclose(found[period:], found[:period], rtol=0.0, atol=1e-11)
    assert np.mean(found[:period] ** 2) == pytest.approx(2.5**2, rel=1e-12)
    power = abs(np.fft.rfft(found[:period])) ** 2 * 2.0 / period**2
    lines = np.arange(power.size) / (period * H)
    middles = low + (high - low) * (np.arange(n) + 0.5) / n
    inside = np.isin(lines.round(9), middles.round(9))
    np.testing.assert_allclose(power[inside], 2.5**2 / n, rtol=1e-10)
    assert power[~inside].max() < 1e-20


def test_noise_depends_on_seed_name_and_signal() -> None:
    """The same three give the same numbers, any other one others."""
    first = samples(band_noise(1.0, (1.0, 9.0), seed=1, signal="force.x", sample_time=H), 9)[1]
    for signal, seed, name, same in (
        ("force.x", 1, "noise", True),
        ("force.y", 1, "noise", False),
        ("force.x", 2, "noise", False),
        ("force.x", 1, "other", False),
    ):
        found = samples(band_noise(1.0, (1.0, 9.0), seed=seed, signal=signal, sample_time=H, name=name), 9)[1]
        assert np.array_equal(found, first) == same


@pytest.mark.parametrize(("start", "duration"), [(0.0, None), (0.004, None), (0.004, 0.02)])
def test_table_is_linear_between_its_rows(tmp_path: Path, start: float, duration: float | None) -> None:
    """Interpolation by numpy, zero before the first row, after the last and after the duration."""
    times, values = np.array([0.005, 0.0201, 0.05]), np.array([1.0, -2.0, 3.0])
    rows = "".join(f"{t!r},{v!r}\n" for t, v in zip(times.tolist(), values.tolist(), strict=True))
    (tmp_path / "force.csv").write_text("time,force.x\n" + rows)
    file = str(tmp_path / "force.csv")
    block = table(file, signal="force.x", sample_time=H, start=start, duration=duration)
    instants, found = samples(block, 90)
    since = instants - start
    acts = (since > 0.005 - 1e-9) & (since < 0.05 + 1e-9) & (since < (duration or 9.0) - 1e-9)
    np.testing.assert_allclose(found, np.where(acts, np.interp(since, times, values), 0.0), rtol=0.0, atol=1e-11)


RIGID: Any = {
    "name": "pushed",
    "cosimulation.drive": "torque",
    "cosimulation.tolerance": 1e-10,
    "cosimulation.step": 1e-3,
    "effects": {"basis": "assumed-modes", "gravity": [0.0, 0.0]},
    "trajectory.duration": 0.2,
    "trajectory.dwell": 0.0,
}
PUSH = [
    {"kind": "pulse", "signal": "force.x", "amplitude": 30.0, "start": 0.0103, "duration": 0.0407},
    {"kind": "pulse", "signal": "joint1.disturbance", "amplitude": 2.0, "start": 0.02, "duration": 0.0311},
    {"kind": "payload", "mass": 4.0, "picked_up": 0.1003, "dropped": 0.15},
]


@pytest.fixture(scope="module")
def pushed() -> tuple[Scene, Run]:
    """A rigid robot without gravity at rest, pushed by a force and a torque; then it picks up 4 kg and drops them."""
    scene = load_scene("barnard2012-6kg").replace({**RIGID, "disturbance": PUSH})
    run = run_scene(scene)
    assert run.completed, run.message
    return scene, run


def energies(scene: Scene, run: Run) -> tuple[Any, Any]:
    """Instants (N,) [s] and the kinetic energy (N,) [J] of links and the scene's payload, by an independent mass matrix."""
    columns = run.recording.columns
    angles = np.column_stack([columns[f"joint{i}.position"].values for i in (1, 2)])
    rates = np.column_stack([columns[f"joint{i}.velocity"].values for i in (1, 2)])
    matrix = load_mass_matrix(scene, angles)
    return run.recording.time, 0.5 * np.einsum("ni,nij,nj->n", rates, matrix, rates)


def test_work_of_force_and_torque_is_kinetic_energy(pushed: tuple[Scene, Run]) -> None:
    """The pulses do the work F dx + tau dq, whose instants aren't those of the communication steps."""
    time, energy = energies(*pushed)
    columns = pushed[1].recording.columns
    first, last = (np.argmin(abs(time - each)) for each in (0.0103, 0.051))
    begin, end = (np.argmin(abs(time - each)) for each in (0.02, 0.0511))
    assert abs(time[[first, last, begin, end]] - [0.0103, 0.051, 0.02, 0.0511]).max() < 1e-12
    x, q = columns["end_effector.position.x"].values, columns["joint1.position"].values
    work = 30.0 * (x[last] - x[first]) + 2.0 * (q[end] - q[begin])
    assert energy[end] == pytest.approx(work, rel=1e-8)
    assert energy[:first].max() < 1e-20


def test_payload_has_the_velocity_of_the_end_effector(pushed: tuple[Scene, Run]) -> None:
    """The energy is constant in each phase; the mass takes 1/2 m v² with it, and velocities are continuous."""
    time, links = energies(*pushed)
    columns = pushed[1].recording.columns
    speed = np.hypot(*(columns[f"end_effector.velocity.{axis}"].values for axis in "xy"))
    carried = (time > 0.1003 + 1e-9) & (time < 0.15 - 1e-9)
    for phase, mass in (((time > 0.052) & (time < 0.1003 - 1e-9), 0.0), (carried, 4.0), (time > 0.15 + 1e-9, 0.0)):
        total = links[phase] + 0.5 * mass * speed[phase] ** 2
        np.testing.assert_allclose(total, total[0], rtol=1e-8)
    # both sides of an instant: the energy of the links, thus of their velocities, is continuous
    for at in (0.1003, 0.15):
        sides = links[abs(time - at) < 1e-12]
        assert sides.size >= 1
        np.testing.assert_allclose(sides, sides[0], rtol=1e-12)
    # without the mass the energy of the links alone isn't constant
    assert np.ptp(links[carried]) > 1e-4 * links[carried].max()


def test_a_mass_from_the_start_on_is_the_payload() -> None:
    """2 kg and 4 kg picked up at once move as 6 kg do, in a flexible robot under gravity that is released undeformed."""
    scene = load_scene("barnard2012-6kg").replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.initial": "undeformed",
            "cosimulation.tolerance": 1e-9,
            "effects.proximal_bending": 1,
            "effects.distal_axial": 0,
            "effects.motor_inertia": 0.1,
            "trajectory.duration": 0.05,
            "trajectory.dwell": 0.0,
            "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 20.0, "sample_time": 1e-3}],
        }
    )
    picked = {"payload.mass": 2.0, "disturbance": [{"kind": "payload", "mass": 4.0, "picked_up": 0.0}]}
    one, other = run_scene(scene), run_scene(scene.replace(picked))
    for name in ("joint1.position", "link11.bending[1]", "end_effector.position.y"):
        found, wanted = (each.recording[name].values[-1] for each in (other, one))
        assert found == pytest.approx(wanted, rel=1e-7, abs=1e-10)


def test_several_in_one_signal_add_up() -> None:
    """The robot gets the sum, at the instants of each."""
    push = {"kind": "step", "signal": "force.x", "amplitude": 2.0, "start": 0.0053}
    wave = {"kind": "sine", "signal": "force.x", "amplitude": 1.0, "frequency": 50.0, "sample_time": 1e-3}
    changes = {**RIGID, "trajectory.duration": 0.02, "disturbance": [push, wave]}
    run = run_scene(load_scene("barnard2012-6kg").replace(changes))
    time, force = run.recording.time, run.recording["force.x"].values
    assert abs(time - 0.0053).min() < 1e-12
    held = np.floor(time / 1e-3 + 1e-6) * 1e-3
    wanted = np.sin(2.0 * np.pi * 50.0 * held) + np.where(time > 0.0053 - 1e-9, 2.0, 0.0)
    # at an instant the recording has the value before the jump or the one after it
    jumps = np.isclose(time, 0.0053, atol=1e-9) | np.isclose(time, np.round(time / 1e-3) * 1e-3, atol=1e-9)
    np.testing.assert_allclose(force[~jumps], wanted[~jumps], **TIGHT)
    assert (~jumps).sum() >= 1 or abs(force - wanted).max() < 1e-12


def test_the_model_depends_on_signals_alone() -> None:
    """Amplitudes share an FMU; a torque and a payload give the robot inputs, a force doesn't."""
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque"})
    force = {"kind": "step", "signal": "force.x", "amplitude": 2.0}
    torque = {**force, "signal": "joint2.disturbance"}
    keys = [
        scene_key(scene.replace({"disturbance": each}))
        for each in ([], [force], [torque], [{**torque, "amplitude": 1.0}])
    ]
    assert keys[0] == keys[1] != keys[2] == keys[3]
    assert depends_on("disturbance.0.signal")
    assert not depends_on("disturbance.0.amplitude")


FORCE: Any = {"signal": "force.x", "amplitude": 1.0}
NOT_FINITE = "time;force.x\n0;1\n0.1;nan\n"


@pytest.mark.parametrize(("changes", "message"), [
    ({"kind": "pulse", **FORCE}, "duration"),
    ({"kind": "step", **FORCE, "signal": "force.z"}, "signal"),
    ({"kind": "noise", "signal": "force.x", "standard_deviation": 1.0, "band": [9.0, 5.0]}, "ascend"),
    ({"kind": "payload"}, "picked_up"),
    ({"kind": "payload", "dropped": 0.1, "mass": 7.0}, "6 kg"),
    ({"kind": "payload", "dropped": 0.1, "picked_up": 0.1, "mass": 7.0}, "after"),
    ({"kind": "payload", "picked_up": 0.1}, "`mass`"),
    # it would be a value that nobody takes
    ({"kind": "step", **FORCE, "start": 5.0}, r"_disturbance begins at 5 s, but the run ends at 0\.\d+ s"),
    ({"kind": "payload", "mass": 1.0, "picked_up": 5.0}, r"_disturbance begins at 5 s, but the run ends at"),
    # a pulse that is too short would never end
    ({"kind": "pulse", **FORCE, "start": 0.1, "duration": 1e-10},
     r"its instants 0\.1 s and 0\.1000000001 s are one at"),
    ("", "can't read"),
    ("time,f\n0,1\n1,2\n", r"line 1: there is no column force\.x \[N\]"),
    ("time,force.x [kN]\n0,1\n", r"column force\.x is in kN; convert it to N"),
    ("time [ms],force.x\n0,1\n", r"column time is in ms; convert it to s"),
    (NOT_FINITE, r"line 3, column force\.x: 'nan' is not a finite number"),
    ("time,force.x\n0.2,1\n0.1,1\n", r"line 3: 0\.1 s comes after 0\.2 s"),
])  # fmt: skip
def test_wrong_keys_and_files_are_refused(changes: dict[str, Any] | str, message: str, tmp_path: Path) -> None:
    """The sentence names the key, the instant, or line and column of a file."""
    if isinstance(changes, str):
        file = tmp_path / "force.csv"
        if changes:
            file.write_text(changes)
        changes = {"kind": "csv", "signal": "force.x", "file": str(file)}
    with pytest.raises((SceneError, CosimError), match=message):
        run_scene(load_scene("barnard2012-6kg").replace({**RIGID, "disturbance": [changes]}))


def test_a_motion_driven_robot_takes_no_disturbance() -> None:
    """It follows its references whatever acts on it; the message says what to set."""
    with pytest.raises(SceneError, match=r"cosimulation\.drive"):
        load_scene("barnard2012-6kg").replace({"disturbance": [{"kind": "payload", "dropped": 0.1}]})


@pytest.mark.parametrize(("text", "scale"), [
    ("time,force.x\n0.001,2\n0.003,4\n", 1.0),
    ("# a log\nt [s];other;force.x [N]\n0.001;7;2\n0.003;7;4\n", 1.0),
    ("time\tforce.x [kN]\n0.001\t0.002\n0.003\t0.004\n", 1000.0),
])  # fmt: skip
def test_a_csv_file_may_have_units_and_semicolons(text: str, scale: float, tmp_path: Path) -> None:
    """As those of motions and logs; with a scale any unit is allowed."""
    file = tmp_path / "force.csv"
    file.write_text(text)
    block = table(str(file), scale=scale, signal="force.x", sample_time=H)
    np.testing.assert_allclose(samples(block, 6)[1], [0.0, 2.0, 3.0, 4.0, 0.0, 0.0], **TIGHT)
