"""The automatic choice of effects compared with runs: drawn scenes of aluminium, tubes and steel, undamped, 1 % damped and more, alone,
with a shaper or in a loop; or a grid of 48 scenes, two robots, three profiles, 0 to 10 kg, 0.2 to 1 s.

For each scene the cheapest set for a tolerance is chosen as `flexfmu run` does it. Then the scene runs with the set and the tolerance
of the choice, and with a richer set and a negligible integration error. The table has the estimated error (safety included, the largest
over the metrics), the verified one that the choice states, the observed one, and estimated over observed, the effectivity.

    python benchmarks/effect_choice.py [--check] [--drawn 60] [--first 0] [--seed 1] [--tolerance 0.01] [--out results/effect_choice]
    python benchmarks/effect_choice.py --check --grid [--every 1] [--search-every 5]

Drawn scenes, 0.15 to 3 s, name the three metrics, so that the residual vibration is judged relative to itself, and are compared with one
mode more in every family than the richest set of the choice has.
On the grid the FMU of the richest set is the reference, and on a part of it all sets of fewer effects are looked for the
smallest one whose observed error is below the tolerance: the chosen one should be at most one effect larger (a mode of a
family, shear and rotary inertia, and foreshortening count as one effect each).

Either writes effect_choice.md and effect_choice.json, shows progress on standard error, and with --check ends with status 1 where a
criterion isn't met. FMUs are built once for each robot and set; payloads are parameters. The drawn scenes take about half an hour of
processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from effect_grid import GRID, Case, drawn
from effect_search import FAMILIES, all_sets, set_size, smallest

from flexfmu.cosim.design.effects.accuracy import MEASURED, NotConvergedError
from flexfmu.cosim.design.effects.choice import choose_effects
from flexfmu.cosim.design.effects.search import SAFETY, one_more
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.model.choice_text import percent, set_text
from flexfmu.model.scene.choice import INTEGRATOR_SHARE, integrator_tolerance
from flexfmu.model.scene.schema import Scene

EFFECTIVITIES, SHARE = (1.0, 10.0), 0.9
"""Where the effectivity should lie, and in how many of the scenes."""


@dataclass(frozen=True)
class Search:
    """The smallest set that would do, and the number of sets that were run to find it."""

    found: str
    size: int
    observed: float
    runs: int


@dataclass(frozen=True)
class Row:
    """One scene: its choice, and errors relative to the metrics' scales."""

    case: Case
    chosen: str
    size: int
    estimated: float
    verified: float
    observed: float
    effectivity: float | None
    search: Search | None
    tolerance: float
    time: float
    """Processor time of the choice [s], with the builds of FMUs that weren't in the cache."""


@dataclass(frozen=True)
class Criterion:
    """What should hold over all scenes."""

    name: str
    met: bool
    finding: str


def main() -> None:
    options = _options()
    cases = GRID if options.grid else drawn(options.drawn, options.seed)[options.first :]
    rows: list[Row] = []
    refused = 0
    for index, case in enumerate(cases[:: options.every]):
        search = bool(options.search_every) and options.grid and index % options.search_every == 0
        for tolerance in options.tolerance:
            try:
                rows.append(
                    examine(case, tolerance, options.margin if search else None, () if options.grid else MEASURED)
                )
                line = _line(rows[-1])
            except NotConvergedError as error:
                line = f"refused: {error}"
                refused += 1
            print(f"[{index + 1}/{len(cases)}] {line}", file=sys.stderr, flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    found = [(each, [row for row in rows if row.tolerance == each]) for each in options.tolerance]
    criteria = [(tolerance, some, tuple(judge(some, tolerance, drawn=not options.grid))) for tolerance, some in found]
    text = "\n".join(report(some, judged, tolerance) for tolerance, some, judged in criteria)
    (options.out / "effect_choice.md").write_text(text, encoding="utf-8")
    data = [
        {"tolerance": tolerance, "safety": SAFETY, "criteria": judged, "scenes": some}
        for tolerance, some, judged in criteria
    ]
    (options.out / "effect_choice.json").write_text(json.dumps(data, indent=2, default=asdict), encoding="utf-8")
    for tolerance, some, judged in criteria:
        print(verdicts(judged, tolerance))
        times = [row.time for row in some]
        print(
            f"- processor time of a choice, builds of FMUs included: median {median(times):.1f} s, at most {max(times):.1f} s"
        )
    print(f"- refused, since a metric doesn't converge with the number of modes: {refused}")
    if options.check and not all(each.met for *_, judged in criteria for each in judged):
        raise SystemExit(1)


def examine(case: Case, tolerance: float, search_margin: float | None = None, asked: tuple[str, ...] = ()) -> Row:
    """Choose the effects of a scene, run the set beside the richest one, or a richer one where metrics are `asked` for, and maybe search for a smaller one."""
    scene, before = case.scene().replace({"cosimulation.tolerance": integrator_tolerance(tolerance)}), _processor_time()
    found = choose_effects(scene, tolerance, asked)
    time, choice, chosen, units = _processor_time() - before, found.section, found.scene, found.scales
    assert choice.verified_in == "scene", case
    richest = one_more(found.chooser.richest, FAMILIES if asked else ())
    reference = metrics_of(PreparedScene(found.chooser.exact(richest)).run(), MEASURED)

    def error(candidate: Scene) -> float:
        metrics = metrics_of(PreparedScene(found.as_run(candidate)).run(), MEASURED)
        return max(abs((metrics[name] or 0.0) - (reference[name] or 0.0)) / units[name] for name in MEASURED)

    stated, verified = (max(each or 0.0 for each in values or ()) for values in (choice.error, choice.verified))
    observed, size, search = error(chosen), set_size(chosen), None
    if search_margin is not None:
        candidates = [*(each for each in all_sets(scene) if set_size(each) < size), chosen]
        best = smallest(candidates, found.chooser.estimates, error, tolerance, search_margin)
        search = Search(set_text(best.scene), set_size(best.scene), best.observed, best.runs) if best else None
    effectivity = stated / observed if observed else None
    return Row(case, set_text(chosen), size, stated, verified, observed, effectivity, search, tolerance, time)


def _processor_time() -> float:
    """Processor time of this process and of its compilers [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def judge(rows: Sequence[Row], tolerance: float, *, drawn: bool) -> Iterator[Criterion]:
    """The criteria, with what was found; for drawn scenes that of the tolerance alone."""
    below = sum(row.observed < tolerance for row in rows)
    largest = percent(max(row.observed for row in rows))
    yield Criterion(
        "observed error below the tolerance", below == len(rows), f"{below} of {len(rows)} scenes, largest {largest}"
    )
    beyond = max(row.observed - row.verified for row in rows)
    yield Criterion(
        "observed error at most a twentieth of the tolerance above the stated bound",
        beyond <= 0.05 * tolerance,
        f"{percent(beyond)} above it at most" if beyond > 0.0 else "never above it",
    )
    if drawn:
        return
    ratios = sorted(row.effectivity for row in rows if row.effectivity is not None)
    least, most = EFFECTIVITIES
    sharp = sum(least <= ratio <= most for ratio in ratios)
    spread = f"{ratios[0]:.2f} to {ratios[-1]:.2f}, median {ratios[len(ratios) // 2]:.2f}" if ratios else "none"
    yield Criterion(
        f"effectivity within {least:g} and {most:g} in {percent(SHARE)}",
        sharp >= SHARE * len(rows),
        f"{sharp} of {len(rows)} scenes, {spread}",
    )
    excess = [row.size - row.search.size for row in rows if row.search is not None]
    if excess:
        small = sum(each <= 1 for each in excess)
        yield Criterion(
            "at most one effect more than the smallest set that would do",
            small == len(excess),
            f"{small} of {len(excess)} scenes, {excess.count(0)} without any more",
        )


def report(rows: Sequence[Row], criteria: Sequence[Criterion], tolerance: float) -> str:
    """The table and the verdicts as Markdown."""
    header = "| Robot | Profile | Payload | Duration | Chosen | Estimated | Verified | Observed | Effectivity | Smallest that would do |"
    lines = (header, "|---|---|---:|---:|---|---:|---:|---:|---:|---|", *map(_line, rows))
    return "\n".join(lines) + "\n\n" + verdicts(criteria, tolerance) + "\n"


def verdicts(criteria: Sequence[Criterion], tolerance: float) -> str:
    """The request, and whether each criterion is met."""
    lines = [f"- {each.name}: {'met' if each.met else 'NOT MET'}, {each.finding}" for each in criteria]
    share = percent((1 - INTEGRATOR_SHARE) * tolerance)
    return "\n".join(
        (f"Tolerance {percent(tolerance)}, of which {share} for effects; safety factor {SAFETY:g}:", "", *lines)
    )


def _line(row: Row) -> str:
    case, best = row.case, row.search
    cells = (
        case.robot,
        ", ".join(
            filter(None, (case.profile, f"{case.damping} damping" if case.damping != "modal" else "", case.around))
        ),
        f"{case.payload:g} kg",
        f"{case.duration:g} s",
        f"{row.size} effects: {row.chosen}",
        percent(row.estimated),
        percent(row.verified),
        percent(row.observed),
        "–" if row.effectivity is None else f"{row.effectivity:.2f}",
        "" if best is None else f"{best.size} effects: {best.found} ({percent(best.observed)}; {best.runs} sets run)",
    )
    return f"| {' | '.join(cells)} |"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="end with status 1 where a criterion isn't met")
    parser.add_argument("--tolerance", type=float, nargs="+", default=[0.01])
    parser.add_argument("--drawn", type=int, default=60, metavar="N", help="number of drawn scenes")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="leave out so many of the drawn scenes")
    parser.add_argument("--grid", action="store_true", help="the grid instead of drawn scenes")
    parser.add_argument("--seed", type=int, default=1, help="of the drawn scenes")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every Nth scene")
    parser.add_argument("--search-every", type=int, default=5, metavar="N", help="search on every Nth; 0: never")
    parser.add_argument(
        "--margin", type=float, default=2.0, help="run sets up to so many tolerances of estimated error; inf: all sets"
    )
    parser.add_argument("--out", type=Path, default=Path("results/effect_choice"))
    return parser.parse_args()


if __name__ == "__main__":
    main()
