"""The automatic choice of effects, held against runs: 48 scenes, two robots, three profiles, 0 to 10 kg, 0.2 to 1 s.

For each scene the cheapest set for a tolerance is chosen by estimates. Then its FMU runs, with the tolerance that the choice gives it,
and so does the FMU of the richest set, exactly. The table has the estimated error (safety included, the largest over the
metrics), the observed one, and their ratio, the effectivity. On some scenes all smaller sets are estimated too, and the smallest that
is within the whole tolerance is run: the chosen one should be at most one effect larger (a mode of a family, shear and
rotary inertia, and foreshortening count as one effect each).

    python benchmarks/effect_choice.py [--tolerance 0.01] [--every 1] [--search-every 8] [--out results/effect_choice]

writes effect_choice.md and effect_choice.csv. FMUs are built once for each robot and set; payloads are parameters.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from flexfmu.cosim.effect_check import EXACT, observe
from flexfmu.cosim.effect_choice import MEASURED
from flexfmu.cosim.planning import plan
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.model.choice_section import INTEGRATOR_SHARE, integrator_tolerance
from flexfmu.model.scene import Scene
from flexfmu.model.scene_file import load_scene
from flexfmu.model.selection.choose import SAFETY, choose_effects
from flexfmu.model.selection.estimator import Estimator
from flexfmu.model.selection.measures import scales
from flexfmu.model.selection.richest import RICHEST, richest, with_set
from flexfmu.model.selection.words import percent, set_text

PAPER = load_scene("barnard2012-6kg")

ROBOTS: dict[str, dict[str, Any]] = {
    "paper": {},
    "tubes": {
        "mechanism.base_half_distance": 0.12,
        "mechanism.proximal": {"length": 0.28, "diameter": 0.030, "inner_diameter": 0.020},
        "mechanism.distal": {"length": 0.42, "diameter": 0.028, "inner_diameter": 0.018},
    },
}
PROFILES: dict[str, dict[str, Any]] = {
    "poly7": {"kind": "poly7"},
    "bang-bang": {"kind": "bang-bang"},
    "trapezoidal": {"kind": "trapezoidal", "ramp": 0.25},
}
TASKS = ((0.0, 0.20), (0.1, 0.30), (0.5, 0.60), (1.0, 0.20), (3.0, 0.30), (6.0, 0.43), (10.0, 0.25), (10.0, 1.00))
"""Payload [kg] and duration [s]."""


@dataclass(frozen=True)
class Row:
    """One scene: its choice, errors relative to the metrics' scales, and the size of the smallest set that would do."""

    robot: str
    profile: str
    payload: float
    duration: float
    chosen: str
    size: int
    estimated: float
    observed: float
    smallest: str = ""
    smallest_size: int | None = None
    smallest_observed: float | None = None

    @property
    def effectivity(self) -> float:
        return self.estimated / self.observed


def main() -> None:
    options = _options()
    rows: list[Row] = []
    for index, case in enumerate(list(itertools.product(ROBOTS, PROFILES, TASKS))[:: options.every]):
        rows.append(
            examine(*case, options.tolerance, search=bool(options.search_every) and index % options.search_every == 0)
        )
        print(_line(rows[-1]), flush=True)
    text = report(rows, options.tolerance)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "effect_choice.md").write_text(text, encoding="utf-8")
    with (options.out / "effect_choice.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, asdict(rows[0]).keys())
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    print(text.rpartition("\n\n")[2])


def examine(robot: str, profile: str, task: tuple[float, float], tolerance: float, *, search: bool) -> Row:
    """Choose the effects of a scene, and run the set beside the richest one."""
    payload, duration = task
    changes = {"trajectory.profile": PROFILES[profile], "payload.mass": payload, "trajectory.duration": duration}
    scene = PAPER.replace({**ROBOTS[robot], **changes, "cosimulation.tolerance": integrator_tolerance(tolerance)})
    motion = plan(scene)
    estimator = Estimator(scene, motion.joints, MEASURED)
    chosen = choose_effects(scene, motion.joints, tolerance, MEASURED, estimator)
    reference = observe(richest(scene), MEASURED, fmu_of, EXACT).metrics
    units = scales(reference)

    def error(candidate: Scene) -> float:
        metrics = observe(candidate, MEASURED, fmu_of).metrics
        return max(abs(metrics[name] - reference[name]) / units[name] for name in MEASURED)

    assert chosen.effects.choice is not None
    estimated, size = max(chosen.effects.choice.error), set_size(chosen)
    row = (robot, profile, payload, duration, set_text(chosen), size, estimated, error(chosen))
    if not search:
        return Row(*row)
    best = smallest(estimator, scene, size, tolerance) or chosen
    return Row(*row, set_text(best), set_size(best), error(best))


def smallest(estimator: Estimator, scene: Scene, below: int, tolerance: float) -> Scene | None:
    """The smallest set of fewer than so many effects whose error is estimated to be within the whole tolerance."""
    candidates = sorted(all_sets(scene), key=set_size)
    for candidate in itertools.takewhile(lambda each: set_size(each) < below, candidates):
        quick = max(estimator.errors(candidate.effects, sharp=False).values())
        if quick < 2 * tolerance and max(estimator.errors(candidate.effects).values()) < tolerance:
            return candidate
    return None


def all_sets(scene: Scene) -> Iterator[Scene]:
    """Every set within the richest one; families of one mode also deflecting statically, where their tips move."""
    families = ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial")
    for counts in itertools.product(*(range(RICHEST[family] + 1) for family in families)):
        modes = dict(zip(families, counts, strict=True))
        single = [family for family, count in modes.items() if count == 1 and family != "distal_bending"]
        statics = itertools.chain.from_iterable(itertools.combinations(single, n) for n in range(len(single) + 1))
        for static, beam, short in itertools.product(list(statics), ("euler-bernoulli", "timoshenko"), (False, True)):
            if short and not (modes["proximal_bending"] or modes["distal_bending"]):
                continue
            yield with_set(scene, {**modes, "quasi_static": list(static), "beam": beam, "foreshortening": short})


def set_size(scene: Scene) -> int:
    """Number of effects: modes of every family, shear and rotary inertia, foreshortening."""
    effects = scene.effects
    modes = effects.proximal_bending + effects.proximal_axial + effects.distal_bending + effects.distal_axial
    return modes + (effects.beam == "timoshenko") + effects.foreshortening


def fmu_of(scene: Scene) -> Path:
    """The FMU of a robot and a set of effects, shared by all payloads and motions."""
    same = {"payload.mass": 1.0, "trajectory": PAPER.trajectory.model_dump(exclude_none=True), "effects.choice": None}
    return build_scene(scene.replace({**same, "cosimulation.tolerance": 1e-4})).path


def report(rows: Iterable[Row], tolerance: float) -> str:
    """The table and the counts as Markdown."""
    rows = list(rows)
    header = "| Robot | Profile | Payload | Duration | Chosen | Estimated | Observed | Effectivity | Smallest that would do |"
    lines = [header, "|---|---|---:|---:|---|---:|---:|---:|---|", *(_line(row) for row in rows)]
    return "\n".join(lines) + "\n\n" + counts(rows, tolerance)


def counts(rows: list[Row], tolerance: float) -> str:
    """How many of the scenes meet each criterion, in words."""
    below = sum(row.observed < tolerance for row in rows)
    sharp = sum(1.0 <= row.effectivity <= 10.0 for row in rows)
    searched = [row for row in rows if row.smallest_size is not None]
    small = sum(row.size - (row.smallest_size or 0) <= 1 for row in searched)
    ratios = sorted(row.effectivity for row in rows)
    return (
        f"Tolerance {percent(tolerance)}, of which {percent((1 - INTEGRATOR_SHARE) * tolerance)} for effects; safety factor {SAFETY:g}. "
        f"Observed error below the tolerance: {below} of {len(rows)} (largest {percent(max(row.observed for row in rows))}). "
        f"Effectivity within 1..10: {sharp} of {len(rows)} ({ratios[0]:.2f} to {ratios[-1]:.2f}, median {ratios[len(ratios) // 2]:.2f}). "
        f"At most one effect more than the smallest set that would do: {small} of {len(searched)} searched.\n"
    )


def _line(row: Row) -> str:
    found = (
        ""
        if row.smallest_size is None
        else f"{row.smallest_size} effects: {row.smallest} ({percent(row.smallest_observed or 0.0)})"
    )
    cells = (
        row.robot,
        row.profile,
        f"{row.payload:g} kg",
        f"{row.duration:g} s",
        f"{row.size} effects: {row.chosen}",
        percent(row.estimated),
        percent(row.observed),
        f"{row.effectivity:.2f}",
        found,
    )
    return f"| {' | '.join(cells)} |"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every Nth scene")
    parser.add_argument(
        "--search-every", type=int, default=8, metavar="N", help="search through all sets on every Nth; 0: never"
    )
    parser.add_argument("--out", type=Path, default=Path("results/effect_choice"))
    return parser.parse_args()


if __name__ == "__main__":
    main()
