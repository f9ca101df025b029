"""What `flexfmu plan` reaches: total time, power, RMS torque and energy, residual vibration over the payload band, and the time it takes.

python benchmarks/planned_motions.py [--json] [--robust] [--method NAME ...] [--damping RATIO] [--limit NAME=VALUE ...] [--cycle] [--front FIGURES] [SCENE ...]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

from flexfmu import load_scene
from flexfmu.cosim.cli.design import with_wishes
from flexfmu.cosim.design.plans.plan_result import PlanResult, summary, write_scene
from flexfmu.cosim.design.plans.planner import METHODS, plan_scene
from flexfmu.cosim.experiment.timing import processor_time
from flexfmu.model.scene.schema import Scene

EXAMPLES = Path(__file__).parents[1] / "examples"
HEAVY = "barnard2012-6kg"
OTHERS: dict[str, dict[str, Any]] = {
    "carbon": {"mechanism.material": {"density": 1600.0, "youngs_modulus": 120e9}},
    "undamped": {"effects.damping": {"kind": "none"}},
    "elbows-in": {"mechanism.working_mode": "elbows-in", "mechanism.assembly_mode": "right"},
    "left-left": {"mechanism.working_mode": "left"},
    "craig-bampton": {"effects.basis": "craig-bampton", "effects.distal_bending": 2},
    "rotor-inertia": {"effects.motor_inertia": 0.1},
    "empty": {"payload.mass": 0.0},
    "steel-tubes": {
        "mechanism.proximal": {"length": 0.2, "diameter": 0.030, "inner_diameter": 0.024}, "payload.mass": 3.0,
        "mechanism.distal": {"length": 0.31, "diameter": 0.025, "inner_diameter": 0.021}, "mechanism.material": {"density": 7850.0, "youngs_modulus": 210e9},
        "effects": {
            "gravity": [0.0, -9.81], "basis": "craig-bampton", "proximal_bending": 1, "distal_bending": 1, "distal_axial": 1,
            "damping": {"kind": "modal", "ratio": 0.01},
        },
        "trajectory.start": [-0.11, 0.27], "trajectory.lift": [0.0, 1.0], "trajectory.height": 0.04, "trajectory.width": 0.22,
        "trajectory.blend": {"kind": "lame", "height": 0.03, "width": 0.04}, "trajectory.duration": 0.40,
    },
    "loop": {
        "cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "imperfection": [{"kind": "encoder", "counts_per_turn": 1e6}],
        "controller": [{"kind": "pid", "proportional": 1e4, "integral": 0.0, "derivative": 100.0, "sample_time": 1e-3}],
    },
    "targets": {
        "plan.cycle": {
            "pause": 0.1, "return_payload": 0.0,
            "targets": [{"position": [0.05, 0.36], "payload": 3.0, "pause": 0.2}, {"position": [-0.1, 0.30], "payload": 1.0}],
        }
    },
    "drives": {
        "motor": {
            "continuous_torque": 1.6, "peak_torque": 4.8, "maximum_speed": 600.0, "torque_speed_curve": [[0.0, 4.8], [300.0, 4.8], [600.0, 2.0]],
            "rotor_inertia": 4.4e-5, "gear_ratio": 25.0, "gear_efficiency": 0.94, "thermal_time_constant": 20.0,
        }
    },
}  # fmt: skip
"""Name → changes of `HEAVY`: other materials, links, assemblies, effects, loads and limits."""

SCENES = ("barnard2012-6kg", "barnard2012-0.1kg", str(EXAMPLES / "tubes.toml"), str(EXAMPLES / "steel.toml"), *OTHERS)


def main() -> None:
    """Plan and print."""
    parser = argparse.ArgumentParser(description="What flexfmu plan reaches.")
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.add_argument("--robust", action="store_true", help="judge in richer models too")
    parser.add_argument("--method", action="append", choices=METHODS, help="only these methods")
    parser.add_argument("--damping", type=float, help="modal damping ratio instead of the scene's")
    parser.add_argument(
        "--limit", action="append", default=[], help="limits as of flexfmu plan, power=free for example"
    )
    parser.add_argument("--front", help="figures as of flexfmu plan, time,power for example")
    parser.add_argument("--cycle", action="store_true", help="with an empty return and pauses of 0.1 s")
    parser.add_argument("--out", type=Path, help="folder for the planned scenes")
    options = parser.parse_args()
    found, loading = [], processor_time()
    for name in options.scenes:
        scene = load_scene(HEAVY).replace({"name": name, **OTHERS[name]}) if name in OTHERS else load_scene(name)
        if options.damping is not None:
            scene = scene.replace({"effects.damping": {"kind": "modal", "ratio": options.damping}})
        wishes: dict[str, Any] = {"cycle.pause": 0.1} if options.cycle else {}
        wishes |= {"front": options.front.split(",")} if options.front else {}
        scene = with_wishes(scene, wishes, options.limit)
        result, first = planned(scene, tuple(options.method or METHODS), robust=options.robust)
        found.append(summary(result))
        if options.out is not None:
            write_scene(result, options.out / f"{result.goals.scene.name}-planned.toml")
        if not options.json:
            show(result, loading + first)
    if options.json:
        print(json.dumps(found, indent=1))


def planned(scene: Scene, methods: tuple[str, ...], *, robust: bool) -> tuple[PlanResult, float]:
    """The plan, with what it does on standard error, and the processor time until its first motion is judged [s]."""
    begin, first = processor_time(), list[float]()

    def told(text: str, fraction: float | None) -> None:
        print(f"  {text}", file=sys.stderr)
        if "µm: " in text:
            first.append(processor_time() - begin)

    result = plan_scene(scene, methods=methods, processes=os.cpu_count() or 1, robust=robust, show=told)
    return result, first[0] if first else math.inf


def show(result: PlanResult, first: float) -> None:
    """Print the chosen motion and the front, and the processor time until the first motion is judged [s], loading included."""
    chosen, given = result.chosen, result.given
    print(
        f"\n{result.goals.scene.name}: {chosen.candidate.label} ({chosen.candidate.method}), CPU {result.cpu_time:.0f} s, first motion after {first:.1f} s"
    )
    print(
        f"  time {chosen.time:.4f} s = {chosen.time / given.time:.3f} of {given.time:g} s; residual {1e6 * chosen.residual:.3f} um"
    )
    for name, unit in (
        ("power", "W"),
        ("supply_power", "W"),
        ("regenerated_power", "W"),
        ("rms_torque", "N.m"),
        ("energy", "J"),
    ):
        value, usual = getattr(chosen, name), getattr(given, name)
        print(f"  {name:18} {value:10.4g} {unit:5} = {value / usual:.3f} of the given motion's")
    for pair in result.ways:
        for label, way in zip(("given", "planned"), pair, strict=True):
            print(
                f"  {label:8} way {way.time:.4f} s residual {1e6 * way.residual:.3f} um torque {way.torque:.4g} N.m "
                f"RMS {way.rms_torque:.4g} N.m power {way.power:.4g} W energy {way.energy:.4g} J"
            )
    for use in chosen.uses:
        print(f"  {use.name:18} {use.value:10.4g} of {use.limit:10.4g} {use.unit:7} {use.where}")
    for row in result.rows():
        figures: dict[str, Any] = row
        print(
            f"    {figures['motion'][:50]:50} {figures['time']:.4f} s {1e6 * figures['residual']:8.3f} um "
            f"torque {figures['torque_ratio']:.3f} RMS {figures['rms_torque']:.4g} N.m power {figures['power']:.4g} W "
            f"energy {figures['energy']:.4g} J jerk {figures['jerk']:.4g} rad/s3 off {1e3 * figures['off_path']:.2f} mm {'' if figures['feasible'] else 'not within limits'}"
        )
    for line in result.robustness:
        print(
            f"  {line.model:40} {1e6 * line.residual:8.3f} um {line.where:24} {', '.join(line.missed or ())} {line.note}"
        )
    for message in result.failures:
        print(f"  failed: {message}")


if __name__ == "__main__":
    main()
