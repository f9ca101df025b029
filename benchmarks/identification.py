"""How often intervals of identified parameters contain the truth, where the data come from another model: finite elements.

python benchmarks/identification.py [--cases 100] [--first 0] [--kind angles|torques|mode|all] [--json FILE]

Each case draws a robot, moves its motors by the scene's motion in finite elements, and makes a log of that (at 1 kHz, torques that drive the model at 4 kHz): encoders of 17 bits,
noise that is coloured (autoregressive, poles drawn), sensors that are 2 ms late, without that being known. Five parameters are
estimated, from first values that are up to 20 % off:

- ``angles``: measured angles drive the model, torques are compared;
- ``torques``: exact torques, as commanded, drive the model, with friction and motor inertia; angles and the end effector's acceleration are compared;
- ``mode``: as ``angles`` with a light payload, and a model that lacks a mode: the bending of the distal links.

Motor inertia and viscous friction add to the motors' torques what the closed form says, since motors move as prescribed.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import flexfmu
from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.finite_elements.motion import equilibrium, simulate
from flexfmu.model.finite_elements.robot import finite_element_robot

STEPS = {"angles": 1e-3, "torques": 5e-4, "mode": 1e-3}
"""Distance of the samples [s]: torques between them are interpolated, also where the links vibrate at 300 Hz."""

DELAY, COUNTS, ELEMENTS = 2e-3, 2**17, 3
NOISE = {"angles": 0.01, "torques": 1e-4, "mode": 0.001, "acceleration": 0.01}
"""Standard deviation of the noise, relative to the largest value; of a missing mode less, which it would hide."""

KEYS = {
    "payload.mass": "payload.mass",
    "damping.time": "effects.damping.time",
    "material.youngs_modulus": "mechanism.material.youngs_modulus",
    "motor_inertia": "effects.motor_inertia",
    "joint_friction.viscous": "effects.joint_friction.viscous",
}


def robot(kind: str) -> flexfmu.Scene:
    """The scene whose parameters are estimated."""
    effects: dict[str, Any] = {
        "gravity": [0.0, -9.81],
        "basis": "craig-bampton",
        "proximal_bending": 2,
        "proximal_axial": 1,
        "distal_axial": 1,
        "foreshortening": True,
        "distal_bending": 0 if kind == "mode" else 1,
        "damping": {"kind": "stiffness", "time": 1e-4},
        "motor_inertia": 0.05,
        "joint_friction": {"viscous": 2.0},
    }
    scene = flexfmu.load_scene("barnard2012-0.1kg" if kind == "mode" else "barnard2012-6kg")
    drive = "torque" if kind == "torques" else "motion"
    return scene.replace({"effects": effects, "cosimulation.drive": drive})


def coloured(count: int, deviation: float, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    """Autoregressive noise of second order with drawn poles."""
    first, second = rng.uniform(0.5, 0.95), rng.uniform(-0.3, 0.5)
    values, white = np.zeros(count + 200), rng.normal(size=count + 200)
    for n in range(2, values.size):
        values[n] = (first + second) * values[n - 1] - first * second * values[n - 2] + white[n]
    return deviation * values[200:] / values[200:].std()


def case(number: int, kind: str) -> dict[str, Any]:
    """Draw, measure and identify one robot."""
    rng, scene = np.random.default_rng([20261128, number]), robot(kind)
    own = {name: float(each.value) for name, each in scene_values(scene).items()}
    true = {name: own[name] * rng.uniform(0.8, 1.25) for name in KEYS}
    built = scene.replace({KEYS[name]: value for name, value in true.items()})
    motion = plan(scene)
    bare = built.replace({"effects.motor_inertia": 0.0, "effects.joint_friction": {}})
    elements = finite_element_robot(bare, ELEMENTS)
    step = STEPS[kind]
    instants = step * np.arange(round(motion.stop_time / step))
    found = simulate(elements, motion.joints, instants[1:], step)
    start, rate, acceleration = motion.joints.evaluate(instants, 2)
    torque = np.vstack([equilibrium(elements, start[0]).torque, found.torque])
    end_effector = np.vstack([np.zeros(2), found.acceleration])
    torque += true["motor_inertia"] * acceleration + true["joint_friction.viscous"] * rate
    bit = 2.0 * np.pi / COUNTS
    columns = {"time": instants}
    late = 0.0 if kind != "torques" else DELAY

    with TemporaryDirectory() as folder:
        for j in range(2):
            exact = motion.joints.evaluate(np.maximum(instants - late, 0.0), 0)[0][:, j]
            # the encoder's zero is anywhere within a count
            zero = rng.uniform()
            columns[f"joint{j + 1}.position"] = bit * (np.round(exact / bit - zero) + zero)
            values = torque[:, j] if kind == "torques" else delayed(torque[:, j], round(DELAY / step))
            size = NOISE[kind] * abs(torque).max()
            noise = rng.normal(0.0, size, instants.size) if kind == "torques" else coloured(instants.size, size, rng)
            columns[f"joint{j + 1}.torque"] = values + noise
            if kind == "torques":
                values = delayed(end_effector[:, j], round(DELAY / step))
                size = NOISE["acceleration"] * abs(end_effector).max()
                columns[f"end_effector.acceleration.{'xy'[j]}"] = values + coloured(instants.size, size, rng)
        log = Path(folder) / "log.csv"
        np.savetxt(log, np.column_stack([*columns.values()]), delimiter=",", header=",".join(columns), comments="")
        begin = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = flexfmu.identify(scene, log, list(KEYS))
    return {
        "case": number,
        "kind": kind,
        "seconds": time.process_time() - begin,
        "true": true,
        "data": result.as_data(),
        "inside": {each.name: each.interval[0] <= true[each.name] <= each.interval[1] for each in result.estimates},
        "error": {each.name: each.value / true[each.name] - 1.0 for each in result.estimates},
        "width": {each.name: each.standard_error / true[each.name] for each in result.estimates},
        "explained": result.is_explained,
    }


def delayed(values: np.ndarray[Any, Any], shift: int) -> np.ndarray[Any, Any]:
    """Values of some samples ago."""
    return np.concatenate([np.full(shift, values[0]), values[: values.size - shift]])


def main() -> None:
    """Print coverage, errors and cost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", choices=["angles", "torques", "mode", "all"], default="all")
    parser.add_argument("--json", type=Path)
    parser.add_argument("-j", "--processes", type=int, default=2)
    chosen = parser.parse_args()
    kinds = ["angles", "torques", "mode"] if chosen.kind == "all" else [chosen.kind]
    rows = []
    for kind in kinds:
        flexfmu.build(robot(kind))
        with ProcessPoolExecutor(chosen.processes) as pool:
            numbers = range(chosen.first, chosen.first + chosen.cases)
            found = [*pool.map(partial(case, kind=kind), numbers)]
        rows += found
        print(f"{kind}: {len(found)} cases, {np.mean([each['seconds'] for each in found]):.2g} s of CPU each")
        for name in KEYS:
            inside = sum(each["inside"][name] for each in found)
            errors = np.array([each["error"][name] for each in found])
            width = np.median([each["width"][name] for each in found])
            print(
                f"  {name:26} interval contains the truth in {inside} of {len(found)}, error {100 * np.sqrt(np.mean(errors**2)):.2g} % RMS, "
                f"standard error {100 * width:.2g} %"
            )
        print(f"  the model is said to lack something in {sum(not each['explained'] for each in found)}", flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
