"""Input shapers against payload errors, with a perfect drive and with a controller: residual vibration, settling time, added
time and peak torque on the paper's 6 kg scene.

The perfect drive follows its references exactly (motion-driven). The controller is PD with computed torque at 1 kHz and
4 kHz; its model has the scene's payload. Flexible links without motors leave next to no inertia at the joints for a fast
velocity feedback to act on, so the motors have 0.1 kg m2 here, with the perfect drive as well. One FMU for each drive;
payloads are parameters.

Residual vibration and settling time are about the point where the robot comes to rest. With the controller this is off the
end pose when the payload is wrong, by the rest offset: it has no integral.

    python benchmarks/shapers_in_the_loop.py [--out results/shapers] [--apply joints|path] [--errors 7] [--only zv ei]

writes shapers_in_the_loop.md and shapers_in_the_loop.csv (SI units).
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from flexfmu import load_scene
from flexfmu.cosim.design.shapers.study import (
    ShapedMotion,
    alternatives,
    candidates,
    design_modes,
    payload_errors,
    simulate,
)
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.scene.schema import Scene

BANDWIDTH = 80.0
"""Of the controlled joints [rad/s], critically damped."""

SCENE = load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})


def controlled(sample_time: float) -> Scene:
    """The scene with PD and computed torque."""
    controller = {
        "kind": "computed-torque",
        "proportional": BANDWIDTH**2,
        "derivative": 2.0 * BANDWIDTH,
        "sample_time": sample_time,
    }
    return SCENE.replace({"cosimulation.drive": "torque", "controller": [controller]})


DRIVES = {
    "perfect drive": SCENE,
    "computed torque, 1 kHz": controlled(1e-3),
    "computed torque, 4 kHz": controlled(0.25e-3),
}


@dataclass(frozen=True)
class Trial:
    """One co-simulation, in SI units; the settling time is None where the dwell was too short for it."""

    drive: str
    shaper: str
    shapes: str
    added_time: float
    payload_error: float
    residual_vibration: float
    settling_time: float | None
    peak_torque: float
    rest_offset: float


def trials(apply: str, errors: int, only: Sequence[str] | None = None) -> Iterator[Trial]:
    """All combinations, the drives one after the other; of the shapers only those named, if any."""
    relative = payload_errors(SCENE, 0.3, errors)
    motion = plan(SCENE)
    tried, _ = candidates(motion, alternatives(design_modes(motion, relative)))
    chosen = [each for each in tried if each.application in (apply, "-") and (only is None or each.name in only)]
    for drive, scene in DRIVES.items():
        fmu = build_scene(scene).path
        for candidate in chosen:
            for error in relative:
                print(f"{drive}: {candidate.name}, payload {error:+.0%}", file=sys.stderr)
                added = candidate.motion.duration - motion.duration
                yield trial(drive, scene, fmu, candidate, added, error)


def trial(drive: str, scene: Scene, fmu: Path, candidate: ShapedMotion, added: float, error: float) -> Trial:
    """Run and measure one combination."""
    found = simulate(replace(candidate, motion=replace(candidate.motion, scene=scene)), error, fmu)
    return Trial(
        drive,
        candidate.name,
        candidate.application,
        added,
        error,
        found.residual,
        found.settling_time,
        found.peak_torque,
        found.rest_offset,
    )


QUANTITIES: dict[str, Callable[[Trial], str]] = {
    "Residual vibration [µm]": lambda each: f"{1e6 * each.residual_vibration:.1f}",
    "Settling time [ms]": lambda each: "–" if each.settling_time is None else f"{1e3 * each.settling_time:.0f}",
    "Peak torque [N·m]": lambda each: f"{each.peak_torque:.1f}",
}


def markdown(found: Sequence[Trial]) -> str:
    """A table for each quantity and drive, shapers in rows, payload errors in columns; the rest offset by drive."""
    errors = list(dict.fromkeys(each.payload_error for each in found))
    shapers = list(dict.fromkeys((each.shaper, each.added_time) for each in found))
    head = [f"{error:+.0%}" for error in errors]
    parts = ["# Input shapers and payload errors, 6 kg", (__doc__ or "").split("\n\n")[1], overview(found)]
    for quantity, text in QUANTITIES.items():
        for drive in DRIVES:
            cells = {(each.shaper, each.payload_error): text(each) for each in found if each.drive == drive}
            rows = [[name, f"{1e3 * added:.1f}", *(cells[name, error] for error in errors)] for name, added in shapers]
            parts += [f"## {quantity}, {drive}, by payload error", table(["Shaper", "Added time [ms]", *head], rows)]
    offsets = {(each.drive, each.payload_error): f"{1e6 * each.rest_offset:.0f}" for each in found}
    rows = [[drive, *(offsets[drive, error] for error in errors)] for drive in DRIVES]
    parts += ["## Rest offset [µm], the same for all shapers, by payload error", table(["Drive", *head], rows)]
    return "\n\n".join(parts) + "\n"


def overview(found: Sequence[Trial]) -> str:
    """A row for each shaper: residual vibration with the right payload / the largest over all payload errors."""
    rows = []
    for shaper in dict.fromkeys(each.shaper for each in found):
        mine = [each for each in found if each.shaper == shaper]
        row = [shaper, f"{1e3 * mine[0].added_time:.1f}"]
        for drive in DRIVES:
            residual = {each.payload_error: each.residual_vibration for each in mine if each.drive == drive}
            nominal = min(residual, key=abs)
            row.append(f"{1e6 * residual[nominal]:.1f} / {1e6 * max(residual.values()):.1f}")
        rows.append(row)
    head = [f"Residual, {drive} [µm]" for drive in DRIVES]
    return table(["Shaper", "Added time [ms]", *head], rows)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, numbers to the right."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, rule, *rows))


def main() -> None:
    """Simulate everything and write both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/shapers"))
    parser.add_argument("--apply", choices=("joints", "path"), default="joints")
    parser.add_argument("--errors", type=int, default=7, help="number of payload errors from -30 %% to +30 %%, odd")
    parser.add_argument("--only", nargs="+", metavar="SHAPER", help="shapers to try, for example unshaped zv ei")
    arguments = parser.parse_args()
    found = list(trials(arguments.apply, arguments.errors, arguments.only))
    if not found:
        parser.error(f"there is no such shaper: {' '.join(arguments.only)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "shapers_in_the_loop.md").write_text(markdown(found), encoding="utf-8")
    with (arguments.out / "shapers_in_the_loop.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(vars(found[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows(vars(each) for each in found)
    print(markdown(found))


if __name__ == "__main__":
    main()
