"""Whether stated errors are true: every metric's error compared with the stated one, for scenes x tolerances x communication steps.

Metrics have the companion's values. The true error is the difference from a run at a tolerance of 1e-12 with steps of 0.1 ms.
How far that is from one at 1e-11 with 0.2 ms is its own uncertainty: where that exceeds half the stated error, the metric is left
out. Held: the true error is at most the stated one. Own: the same for the run's own value and error. Near: the true error of
the run's own value is at least a hundredth of the stated one. Gain: the run's own stated error over that of the companion, the
median. Cost: processor time of a companion, preparing and measuring included, over that of the run and its metrics.

    python benchmarks/stated_errors.py [SCENE ...] [--companions 1] [--worst 0] [--list] [--json] [--drawn N --seed S]

takes about ten minutes for all scenes. The shares of `flexfmu.cosim.many.prepared_scene` were chosen on these scenes; with --drawn,
N scenes are drawn instead, each with a step and a tolerance of its own, on which nothing was chosen if the seed is new.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from statistics import median
from time import process_time
from typing import Any

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.schema import Scene

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
STEPS = (2e-4, 1e-3, 5e-3, 2e-2)
REFERENCES = ((1e-12, 1e-4), (1e-11, 2e-4))
"""Tolerance and communication step [s] of the reference, and of the run that tells how good it is."""

NEAR = 1e-2
HEAVY, LIGHT = "barnard2012-6kg", "barnard2012-0.1kg"
UNDAMPED = {"effects.damping": {"kind": "none"}}
TORQUES = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1}
PD = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}
RELEASED = {**TORQUES, "cosimulation.initial": "undeformed", "trajectory.duration": 0.2, "trajectory.dwell": 0.1}

SCENES: Mapping[str, tuple[str, dict[str, Any]]] = {
    "6 kg": (HEAVY, {}),
    "0.1 kg": (LIGHT, {}),
    "6 kg, undamped": (HEAVY, UNDAMPED),
    "0.1 kg, undamped, bang-bang": (LIGHT, {**UNDAMPED, "trajectory.profile": {"kind": "bang-bang"}}),
    "all families, Rayleigh, trapezoidal": (
        HEAVY,
        {
            "effects.basis": "craig-bampton",
            "effects.proximal_axial": 1,
            "effects.distal_bending": 2,
            "effects.beam": "timoshenko",
            "effects.foreshortening": True,
            "effects.damping": {"kind": "rayleigh", "rate": 5.0, "time": 2e-5},
            "trajectory.profile": {"kind": "trapezoidal", "ramp": 0.25},
        },
    ),
    "stiffness damping, 10 s": (HEAVY, {"effects.damping": {"kind": "stiffness", "time": 10.0}}),
    "stiffness damping, 0.1 ms, fast": (
        LIGHT,
        {
            "effects.distal_bending": 2,
            "effects.damping": {"kind": "stiffness", "time": 1e-4},
            "trajectory.duration": 0.15,
        },
    ),
    "undamped, undeformed, trapezoidal": (
        HEAVY,
        {
            **UNDAMPED,
            "cosimulation.initial": "undeformed",
            "trajectory.profile": {"kind": "trapezoidal", "ramp": 0.125},
        },
    ),
    "rigid": (HEAVY, {**UNDAMPED, "effects.proximal_bending": 0, "effects.distal_axial": 0}),
    "shaped, ZVD": (HEAVY, {"shaper": [{"kind": "zvd", "modes": "along-path"}]}),
    "PD": (HEAVY, {**TORQUES, "controller": [PD]}),
    "PD, undamped": (HEAVY, {**TORQUES, **UNDAMPED, "controller": [PD]}),
    "PD, 0.1 kg, undamped": (LIGHT, {**TORQUES, **UNDAMPED, "controller": [PD]}),
    "PD, friction": (
        HEAVY,
        {**TORQUES, "controller": [PD], "effects.joint_friction": {"viscous": 0.5, "coulomb": 1.0}},
    ),
    "PD, elastic transmissions": (
        HEAVY,
        {**TORQUES, "controller": [PD], "effects.transmission": {"stiffness": 2e4, "damping": 5.0}},
    ),
    "computed torque, 4 kHz": (
        HEAVY,
        {
            **TORQUES,
            "controller": [{"kind": "computed-torque", "proportional": 4e3, "derivative": 90.0, "sample_time": 2.5e-4}],
        },
    ),
    "PD + feedforward, encoder, noise": (
        HEAVY,
        {
            **TORQUES,
            "controller": [PD, {"kind": "feedforward", "sample_time": 1e-3}],
            "imperfection": [
                {"kind": "encoder", "counts_per_turn": 1e6, "window": 1},
                {"kind": "noise", "signal": "velocity", "standard_deviation": 1e-3, "seed": 3},
            ],
        },
    ),
    "released": (HEAVY, RELEASED),
    "released, friction": (HEAVY, {**RELEASED, "effects.joint_friction": {"viscous": 0.5, "coulomb": 3.0}}),
}
"""Name → shipped scene and what is changed in it."""


@dataclass(frozen=True)
class Judged:
    """One metric of one run.

    Attributes:
        scene, tolerance, step, metric: which [step in s].
        value, true, stated: the metric, its error and the stated one, in its SI unit.
        own_true, own_stated: the errors of the run's own value.
    """

    scene: str
    tolerance: float
    step: float
    metric: str
    value: float
    true: float
    stated: float
    own_true: float
    own_stated: float

    @property
    def is_held(self) -> bool:
        """Whether the stated error is at least the true one."""
        return self.true <= self.stated

    @property
    def own_is_held(self) -> bool:
        """The same for the run's own value."""
        return self.own_true <= self.own_stated

    @property
    def is_near(self) -> bool:
        """Whether the stated error of the run's own value is at most a hundred times the true one."""
        return self.own_true >= NEAR * self.own_stated


@dataclass
class Row:
    """One line of the table: a scene, or a tolerance, or a step."""

    name: str
    judged: int
    held: float
    own: float
    near: float
    gain: float
    left_out: int
    cost: float | None = None


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Whether stated errors hold.")
    parser.add_argument("scenes", nargs="*", help="names of the scenes; all by default")
    parser.add_argument("--companions", type=int, default=1, help="companion runs for each error, 1 or 2")
    parser.add_argument("--worst", type=int, default=0, help="also list so many metrics that are furthest from held")
    parser.add_argument("--list", action="store_true", help="also list every metric of every run")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.add_argument("--drawn", type=int, default=0, help="number of scenes that are drawn, instead of the others")
    parser.add_argument("--seed", type=int, default=0, help="seed of the drawn scenes")
    options = parser.parse_args()
    rows, judged = [], []
    random = np.random.default_rng(options.seed)
    drawn = {f"drawn {number}": draw(random) for number in range(options.drawn)}
    for name in drawn or options.scenes or SCENES:
        scene, settings = drawn[name] if drawn else (scene_of(name), (TOLERANCES, STEPS))
        row, found = judge(name, *settings, companions=options.companions, scene=scene)
        judged += found
        rows.append(row)
        if not options.json:
            show(row)
    total_left = sum(row.left_out for row in rows)
    rows += [
        summary_row(f"tolerance {each:g}", [one for one in judged if one.tolerance == each]) for each in TOLERANCES
    ]
    rows += [summary_row(f"step {1e3 * each:g} ms", [one for one in judged if one.step == each]) for each in STEPS]
    rows.append(summary_row("all", judged, total_left))
    if options.json:
        print(json.dumps([asdict(row) for row in rows], indent=2))
        return
    for row in rows[-len(TOLERANCES) - len(STEPS) - 1 :]:
        show(row)
    worst = sorted(judged, key=lambda one: one.stated / max(one.true, 1e-300))[: options.worst]
    for one in judged if options.list else worst:
        settings = f"{one.scene}, {one.tolerance:g}, {1e3 * one.step:g} ms"
        print(f"{settings:50} {one.metric:30} {one.value:13.6g}   true {one.true:8.1e}   stated {one.stated:8.1e}")


def scene_of(name: str) -> Scene:
    """One of `SCENES`."""
    base, changes = SCENES[name]
    return load_scene(base).replace(changes)


def draw(random: np.random.Generator) -> tuple[Scene, tuple[Sequence[float], Sequence[float]]]:
    """A scene with drawn payload, motion, links, damping and drive; its tolerance and its step."""
    uniform = random.uniform
    changes: dict[str, Any] = {
        "payload.mass": round(uniform(0.0, 8.0), 3),
        "trajectory.duration": round(uniform(0.2, 0.8), 4),
        "trajectory.dwell": round(uniform(0.02, 0.3), 4),
        "mechanism.proximal.diameter": round(uniform(0.03, 0.05), 4),
    }
    step = float(random.choice([2e-4, 5e-4, 1e-3]))
    dampings: list[dict[str, Any]] = [
        {"kind": "modal", "ratio": round(uniform(0.01, 0.2), 4)},
        {"kind": "stiffness", "time": float(10.0 ** uniform(-5.5, -4.0))},
        {"kind": "none"},
    ]
    changes["effects.damping"] = dampings[random.choice(3, p=[0.5, 0.3, 0.2])]
    profiles = ({"kind": "poly7"}, {"kind": "bang-bang"}, {"kind": "trapezoidal", "ramp": 0.25}, {"kind": "poly5"})
    changes["trajectory.profile"] = profiles[random.integers(4)]
    if random.random() < 0.35:
        gains = {
            "proportional": round(uniform(3e3, 8e3)),
            "derivative": round(uniform(40.0, 90.0)),
            "sample_time": 1e-3,
        }
        changes |= {
            **TORQUES,
            "effects.motor_inertia": round(uniform(0.05, 0.3), 3),
            "controller": [{"kind": "pd", **gains}],
        }
    tolerance = float(random.choice([1e-4, 1e-6, 1e-6, 1e-8]))
    return load_scene(HEAVY).replace(changes), ([tolerance], [step])


def judge(
    name: str,
    tolerances: Sequence[float] = TOLERANCES,
    steps: Sequence[float] = STEPS,
    companions: int = 1,
    scene: Scene | None = None,
) -> tuple[Row, list[Judged]]:
    """All runs of a scene, by default the one of that name, against its reference."""
    scene = scene_of(name) if scene is None else scene
    exact, other = (measured(scene, *settings, companions=0)[0] for settings in REFERENCES)
    judged, left_out, costs = [], 0, [0.0, 0.0]
    for tolerance, step in product(tolerances, steps):
        found, own, companion = measured(scene, tolerance, step, companions=companions)
        costs = [costs[0] + own, costs[1] + companion]
        comparisons = list(compare(found, exact, other))
        judged += [Judged(name, tolerance, step, *each) for each in comparisons if each is not None]
        left_out += sum(each is None for each in comparisons)
    return summary_row(name, judged, left_out, costs[1] / costs[0]), judged


def measured(
    scene: Scene, tolerance: float, step: float, *, companions: int
) -> tuple[Mapping[str, Metric], float, float]:
    """The metrics of one run; processor times of the run with its metrics and of the companions [s]."""
    begin = process_time()
    run = run_scene(scene, tolerance=tolerance, communication_step=step)
    if not run.completed:
        raise SystemExit(f"{scene.name} at {tolerance:g} with {step:g} s: {run.message}")
    found = measure_run(run, companions=0)
    own = process_time() - begin
    if companions:
        begin, found = process_time() + own, measure_run(run, companions)
    return found, own, process_time() - begin


def compare(
    found: Mapping[str, Metric], exact: Mapping[str, Metric], other: Mapping[str, Metric]
) -> Iterator[tuple[str, float, float, float, float, float] | None]:
    """Name, value, true and stated errors of each metric that has these; None where the reference can't tell."""
    for name, one in found.items():
        values = exact[name].value, other[name].value
        if one.value is None or one.error is None or values[0] is None or values[1] is None:
            continue
        if one.own is None or one.own_error is None:
            continue
        doubt, true, own = abs(values[0] - values[1]), abs(one.value - values[0]), abs(one.own - values[0])
        yield None if doubt > 0.5 * one.error else (name, one.value, true, one.error, own, one.own_error)


def summary_row(name: str, judged: Sequence[Judged], left_out: int = 0, cost: float | None = None) -> Row:
    """Shares of what was judged; nothing judged counts as held."""
    count = max(len(judged), 1)
    shares = (
        1.0 - sum(each) / count
        for each in zip(*((not one.is_held, not one.own_is_held, not one.is_near) for one in judged), strict=True)
    )
    held, own, near = shares if judged else (1.0, 1.0, 1.0)
    gain = median(one.own_stated / max(one.stated, 1e-300) for one in judged) if judged else 1.0
    return Row(name, len(judged), held, own, near, gain, left_out, cost)


def show(row: Row) -> None:
    """One line."""
    cost = "" if row.cost is None else f"   companion costs {row.cost:.1f} x"
    left = f"   {row.left_out} left out" if row.left_out else ""
    print(
        f"{row.name:38} {row.judged:5d} metrics   held {100 * row.held:6.2f} %   own {100 * row.own:6.2f} %   "
        f"near {100 * row.near:6.2f} %   gain {row.gain:5.1f}{cost}{left}",
        flush=True,
    )


if __name__ == "__main__":
    main()
