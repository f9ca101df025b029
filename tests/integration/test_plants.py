"""Both plants through plain fmpy, with either basis and rigid: against each other, SciPy, statics, and their own energy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.numeric import inverse_dynamics, numeric_model, standstill
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

TORQUES = ("joint1.torque", "joint2.torque")


class Plant:
    """The FMU of a scene through plain fmpy, in initialization mode."""

    def __init__(self, scene: Scene, folder: Path, tolerance: float) -> None:
        path = build_fmu(lambda: build_model(scene), output=folder / "plant.fmu").path
        description = fmpy.read_model_description(str(path))
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), str(folder / "unpacked")),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="plant",
        )
        self.slave.instantiate()
        self.slave.setupExperiment(tolerance=tolerance, startTime=0.0)
        self.slave.enterInitializationMode()

    def set(self, names: Sequence[str], values: np.ndarray) -> None:
        self.slave.setReal([self.references[name] for name in names], [float(value) for value in values])

    def get(self, names: Sequence[str]) -> np.ndarray:
        return np.array(self.slave.getReal([self.references[name] for name in names]))

    def set_derivatives(self, names: Sequence[str], derivatives: np.ndarray) -> None:
        for order, values in enumerate(derivatives, start=1):
            self.slave.setRealInputDerivatives(
                [self.references[name] for name in names], [order] * len(names), [float(value) for value in values]
            )

    def close(self) -> None:
        self.slave.terminate()
        self.slave.freeInstance()


def torque_scene(changes: dict[str, object] | None = None) -> Scene:
    return load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", **(changes or {})})


def torque_jets(recording: Recording) -> np.ndarray:
    """Torques with two derivatives at every row, shape (N, 3, 2)."""
    columns = [recording.columns[name] for name in TORQUES]
    return np.stack([np.stack([c.values, c.first, c.second], axis=1) for c in columns], axis=2)


def replay(scene: Scene, recording: Recording, folder: Path, tolerance: float) -> float:
    """Largest deviation of the motor angles [rad] when the recorded torques drive the torque-driven plant."""
    plant = Plant(scene, folder, tolerance)
    jets, time = torque_jets(recording), recording.time
    plant.set(TORQUES, jets[0, 0])
    plant.slave.exitInitializationMode()
    joints = ("joint1.position", "joint2.position")
    references = np.stack([recording.columns[f"joint{i}.reference.position"].values for i in (1, 2)], axis=1)
    worst = 0.0
    for k in np.flatnonzero(np.diff(time) > 0.0):
        plant.set(TORQUES, jets[k, 0])
        plant.set_derivatives(TORQUES, hermite_derivatives(jets[k], jets[k + 1], time[k + 1] - time[k])[1:])
        plant.slave.doStep(time[k], time[k + 1] - time[k])
        worst = max(worst, float(np.abs(plant.get(joints) - references[k + 1]).max()))
    plant.close()
    return worst


def test_recorded_torques_reproduce_the_motion_and_converge(tmp_path: Path) -> None:
    """What the motion-driven plant puts out drives the torque-driven one along the same motion, the nearer the tighter the
    tolerance and the finer the steps: inverse and direct elastodynamic model belong together."""
    scene = load_scene("barnard2012-6kg").replace({"trajectory.dwell": 0.0})
    errors = []
    for number, (tolerance, step) in enumerate(((1e-6, 4e-4), (1e-8, 2e-4), (1e-10, 1e-4))):
        recording = run_scene(scene, tolerance=tolerance, communication_step=step).recording
        folder = tmp_path / str(number)
        folder.mkdir()
        errors.append(replay(torque_scene(), recording, folder, tolerance))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-8


FREE = {"effects.damping": {"kind": "none"}, "cosimulation.initial": "undeformed"}
"""The undamped robot, let go from its undeformed start pose."""


@pytest.mark.parametrize(
    ("drive", "tolerance", "steps"),
    [("motion", 1e-10, 100_000), ("torque", 1e-12, 1500)],
    ids=["motors locked", "falling"],
)
def test_unforced_and_undamped_it_keeps_its_energy(drive: str, tolerance: float, steps: int, tmp_path: Path) -> None:
    """Ten seconds of free vibration with locked motors, and a fall under gravity, neither gain nor lose 1e-9 of the energy of the
    vibration, or of what the fall turns from potential into kinetic energy."""
    scene = load_scene("barnard2012-6kg").replace(FREE | {"cosimulation.drive": drive})
    names, numeric, plant = build_model(scene).unknowns, numeric_model(scene), Plant(scene, tmp_path, tolerance)
    joints = motor_angles(scene.mechanism, scene.trajectory.start)
    rates = [f"joint{name[5]}.velocity" if name.startswith("joint") else f"der({name})" for name in names]
    n = numeric.n

    def energies() -> np.ndarray:
        """Kinetic and potential energy [J]."""
        y, v = plant.get(names), plant.get(rates)
        u = standstill(joints) if drive == "motion" else np.concatenate([y[:2], v[:2], np.zeros(2)])
        return np.asarray(numeric.energy(y[-n:], v[-n:], u).full()).ravel()

    if drive == "torque":
        plant.set(TORQUES, np.zeros(2))
    plant.slave.exitInitializationMode()
    start, turned, drift = float(energies().sum()), 0.0, 0.0
    for step in range(steps):
        plant.slave.doStep(step * 1e-4, 1e-4)
        if step % 50 == 0 or drive == "torque":
            kinetic, potential = energies()
            turned, drift = max(turned, kinetic), max(drift, abs(kinetic + potential - start))
    plant.close()
    if drive == "motion":
        turned = start - float(
            numeric.energy(static_equilibrium(scene, joints).elastic, np.zeros(n), standstill(joints))[1]
        )
        assert turned > 0.0
    else:
        assert turned > 1.0
    assert drift <= 1e-9 * turned


def test_a_torque_step_gives_the_response_that_scipy_gives(tmp_path: Path) -> None:
    """The C integrator and SciPy's DOP853 on the CasADi functions agree to 1e-10 of the response."""
    scene = torque_scene()
    model = build_model(scene)
    n, functions = model.degrees_of_freedom, model.functions
    derived = functions["derive"]([variable.start for variable in model.parameters])
    plant = Plant(scene, tmp_path, tolerance=1e-12)
    plant.slave.exitInitializationMode()
    rates = ("joint1.velocity", "joint2.velocity", *(f"der({name})" for name in model.unknowns[2:]))
    start = np.concatenate([plant.get(model.unknowns), plant.get(rates)])
    u = np.array([variable.start for variable in model.inputs])
    u[0] += 5.0

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        bias = functions["residual"](x[:n], x[n:], np.zeros(n), u, derived).full().ravel()
        return np.concatenate([x[n:], -np.linalg.solve(functions["mass_matrix"](x[:n], u, derived).full(), bias)])

    stop, steps = 0.004, 10
    solution = solve_ivp(rate, (0.0, stop), start, method="DOP853", rtol=1e-12, atol=1e-16)
    plant.set(TORQUES, u[:2])
    for step in range(steps):
        plant.slave.doStep(step * stop / steps, stop / steps)
    end = np.concatenate([plant.get(model.unknowns), plant.get(rates)])
    plant.close()
    response = np.abs(solution.y - start[:, None]).max(axis=1)
    difference = np.abs(end - solution.y[:, -1])
    assert difference[:n].max() <= 1e-10 * response[:n].max()
    assert difference[n:].max() <= 1e-10 * response[n:].max()


@pytest.mark.parametrize("drive", ["motion", "torque"])
def test_the_fmu_finds_the_equilibrium_that_the_model_finds(drive: str, tmp_path: Path) -> None:
    """At rest nothing moves, and the end effector hangs where the Python model says, also at another start pose."""
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.drive": drive})
    path = build_fmu(lambda: build_model(scene), output=tmp_path / "plant.fmu").path
    for start in (scene.trajectory.start, (0.05, 0.3)):
        values = {"start.x": start[0], "start.y": start[1]}
        result = fmpy.simulate_fmu(str(path), stop_time=0.01, output_interval=1e-3, start_values=values)
        expected = static_equilibrium(scene, motor_angles(scene.mechanism, start)).position
        for axis in (0, 1):
            np.testing.assert_allclose(result[f"end_effector.position.{'xy'[axis]}"], expected[axis], atol=1e-12)


def test_an_acceleration_at_the_start_loads_the_motion_not_its_equilibrium(tmp_path: Path) -> None:
    """Motion profiles that jump at t = 0 start from rest: the deflection there is that of gravity alone."""
    scene = load_scene("barnard2012-6kg")
    path = build_fmu(lambda: build_model(scene), output=tmp_path / "plant.fmu").path
    result = fmpy.simulate_fmu(
        str(path), stop_time=1e-4, output_interval=1e-4, start_values={"joint1.reference.acceleration": 100.0}
    )
    at_rest = static_equilibrium(scene, motor_angles(scene.mechanism, scene.trajectory.start))
    assert result["link11.bending[1]"][0] == pytest.approx(at_rest.elastic[0], rel=1e-9)
    assert abs(result["der(link11.bending[1],2)"][0]) > 1.0


METRICS = ("peak_position_error", "peak_torque_1", "residual_vibration_amplitude", "rms_acceleration_error")
FAMILIES = ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial")


def with_shapes(scene: Scene, *counts: int) -> Scene:
    """The scene with so many Craig-Bampton shapes of each family."""
    shapes = {f"effects.{family}": count for family, count in zip(FAMILIES, counts, strict=True)}
    return scene.replace({"effects.basis": "craig-bampton"} | shapes)


def metrics(scene: Scene) -> dict[str, float]:
    measured = measure_run(run_scene(scene))
    values = {name: measured[name].value for name in METRICS}
    return {name: value for name, value in values.items() if value is not None}


@pytest.mark.parametrize(("mass", "duration"), [(0.1, 0.30), (2.0, 0.35)])
def test_the_starter_scene_is_close_to_the_converged_robot(mass: float, duration: float) -> None:
    """Whoever starts from it gets a residual vibration within 1 %, as with the paper's light payload, where its own basis is 37 % off."""
    scene = load_scene("starter").replace({"payload.mass": mass, "trajectory.duration": duration})
    found, reference = (metrics(each) for each in (scene, with_shapes(scene, 3, 2, 2, 2)))
    assert set(found) == set(METRICS)
    for key in METRICS:
        assert found[key] == pytest.approx(reference[key], rel=0.01), key


@pytest.mark.parametrize("name", ["barnard2012-6kg", "barnard2012-0.1kg"])
def test_six_coordinates_beat_the_papers_twelve(name: str) -> None:
    """1 + 1 + 1 shapes a leg are nearer to the converged robot in every metric; with damping that knows no basis."""
    scene = load_scene(name).replace({"effects.damping": {"kind": "stiffness", "time": 2e-4}})
    reference = metrics(with_shapes(scene, 3, 2, 2, 2))
    six, twelve = (metrics(each) for each in (with_shapes(scene, 1, 0, 1, 1), scene))
    assert set(reference) == set(METRICS)
    for key in METRICS:
        assert abs(six[key] - reference[key]) < abs(twelve[key] - reference[key]), key


RIGID = {"effects.proximal_bending": 0, "effects.distal_axial": 0}


def scene(changes: dict[str, object]) -> Scene:
    return load_scene("barnard2012-6kg").replace({"cosimulation.step": 1e-3} | changes)


def columns(recording: Recording, *names: str) -> np.ndarray:
    return np.stack([recording[name].values for name in names])


def test_a_rigid_robot_needs_the_torques_of_inverse_dynamics() -> None:
    """Without any state the FMU is a formula, and the end effector is where the rigid robot has it."""
    recording = run_scene(scene(RIGID)).recording
    kinds = ("position", "velocity", "acceleration")
    motion = [columns(recording, *(f"joint{i}.reference.{kind}" for i in (1, 2))) for kind in kinds]
    expected = inverse_dynamics(scene(RIGID)).map(len(recording.time))(*motion).full()
    torque = columns(recording, "joint1.torque", "joint2.torque")
    np.testing.assert_allclose(torque, expected, atol=1e-9 * np.abs(expected).max())
    position = [
        columns(recording, *(f"end_effector.{kind}.{axis}" for axis in "xy"))
        for kind in ("position", "reference.position")
    ]
    np.testing.assert_allclose(*position, atol=1e-12)


def test_a_rigid_robot_stays_where_its_torques_hold_it() -> None:
    """Torque-driven, the motors' angles are the only unknowns, and the holding torques balance gravity."""
    recording = run_scene(scene(RIGID | {"cosimulation.drive": "torque", "trajectory.dwell": 0.0})).recording
    joints = columns(recording, "joint1.position", "joint2.position")
    assert np.abs(joints - joints[:, :1]).max() < 1e-8


@pytest.mark.parametrize("family", ["distal_bending", "proximal_axial"])
def test_one_family_alone_runs(family: str) -> None:
    """Pinned links that bend move neither elbows nor end effector: their motion is resolved all the same, by what bends."""
    one = scene(RIGID | {f"effects.{family}": 1, "effects.basis": "craig-bampton"})
    name = "link12.bending[1]" if family == "distal_bending" else "link11.axial[1]"
    loose, tight = (PreparedScene(one, tolerance=tolerance).run() for tolerance in (1e-6, 1e-10))
    assert loose.completed, loose.message
    found, exact = (run.recording[name].values for run in (loose, tight))
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()


def test_a_slow_motion_bends_the_links_statically() -> None:
    """Far below the first frequency, links without states err by what the vibration adds, which falls with the duration."""
    full = {"effects.basis": "craig-bampton", "effects.proximal_bending": 1, "effects.distal_axial": 1}
    errors = []
    for duration in (0.6, 1.2):
        vibrating = scene(full | {"trajectory.duration": duration})
        static = vibrating.replace({"effects.quasi_static": ["proximal_bending", "distal_axial"]})
        peak, found = (
            measure_run(run_scene(each), companions=0)["peak_position_error"].value for each in (vibrating, static)
        )
        assert peak is not None
        assert found is not None
        errors.append(abs(found / peak - 1.0))
    assert errors[1] < 0.02
    assert errors[1] < 0.4 * errors[0]
