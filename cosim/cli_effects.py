"""`flexfmu effects`: every effect with what it is worth and what it costs, and the cheapest set within a tolerance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.cli_console import print_rich, print_text, progress
from flexfmu.cosim.effect_check import Comparison, check_choice
from flexfmu.cosim.effect_choice import EffectRow, EffectStudy, study_effects
from flexfmu.cosim.effect_summary import choice_summary
from flexfmu.cosim.json_text import to_json
from flexfmu.cosim.metric_table import METRICS
from flexfmu.model.choice_section import INTEGRATOR_SHARE, Choice, integrator_tolerance
from flexfmu.model.scene_file import load_scene
from flexfmu.model.selection.words import percent, set_text


def effects_command(source: str, tolerance: float | None, of: list[str], check: bool, as_json: bool) -> int:
    """Choose the effects of a scene, print what each is worth; the exit status."""
    scene = load_scene(source)
    with progress() as show:
        study = study_effects(scene, tolerance, tuple(of), show)
        comparisons = check_choice(study, show=show) if check else ()
    if as_json:
        print_text(to_json(_as_data(study, comparisons)))
    else:
        print_rich(*_report(study), *(_check_report(comparisons) if check else ()))
    return 0


def _as_data(study: EffectStudy, comparisons: Iterable[Comparison]) -> dict[str, Any]:
    """Everything as plain data in SI units; errors and contributions are relative to `scales`."""
    choice = study.choice
    data: dict[str, Any] = {
        "scene": study.scene.name,
        **choice_summary(study.scene),
        "limit": (1.0 - INTEGRATOR_SHARE) * choice.tolerance,
        "scales": dict(study.estimator.scales),
        "cost": vars(study.cost),
        "poses": [pose.to_dict() for pose in study.poses],
        "effects": [_row_data(choice, row) for row in study.rows],
    }
    found = [
        {
            "effect": each.effect,
            "change": each.change,
            "estimated": dict(each.estimated),
            "observed": dict(each.observed),
            "effectivity": each.effectivity,
            "slower": each.slower,
        }
        for each in comparisons
    ]
    return data | ({"check": found} if found else {})


def _row_data(choice: Choice, row: EffectRow) -> dict[str, Any]:
    return {
        "effect": row.estimate.effect,
        "change": row.estimate.change,
        "chosen": row.estimate.chosen,
        "contribution": dict(zip(choice.of, row.estimate.contribution, strict=True)),
        "cost": vars(row.cost),
        "poses": [pose.to_dict() for pose in row.poses],
    }


def _report(study: EffectStudy) -> list[RenderableType]:
    """The table of all effects, and the choice in words."""
    choice, parts = study.choice, list[RenderableType]()
    table = _table(f"{study.scene.name}: what each effect is worth, relative change of each metric")
    for heading in ("", "Effect", "Change"):
        table.add_column(heading, no_wrap=heading != "Change")
    for name in (*choice.of, "operations", "time", "f1 [Hz]"):
        table.add_column(METRICS[name].label if name in METRICS else name, justify="right", overflow="fold")
    table.add_row("", "the set itself", "", *("" for _ in choice.of), *_own_cost(study))
    for row in study.rows:
        estimate = row.estimate
        shares = (percent(share) for share in estimate.contribution)
        table.add_row("in" if estimate.chosen else "out", estimate.effect, estimate.change, *shares, *_cost(study, row))
    parts.append(table)
    worst = ", ".join(
        f"{METRICS[name].label.lower()} {percent(value)}" for name, value in zip(choice.of, choice.error, strict=True)
    )
    limit = (1.0 - INTEGRATOR_SHARE) * choice.tolerance
    parts.append(Text(f"chosen for {percent(choice.tolerance)}: {set_text(study.scene)}"))
    parts.append(Text(f"estimated error of this set: {worst}; it may be {percent(limit)}"))
    parts.append(Text(f"tolerance of the FMU: {integrator_tolerance(choice.tolerance):g}"))
    return parts


def _own_cost(study: EffectStudy) -> tuple[str, str, str]:
    """Operations, time and lowest frequencies of the chosen set."""
    return str(study.cost.operations), f"{1e6 * study.cost.time:.3g} µs", _lowest(study.poses)


def _cost(study: EffectStudy, row: EffectRow) -> tuple[str, str, str]:
    """What the set with this row's change costs more or less, and its lowest frequencies."""
    operations = row.cost.operations - study.cost.operations
    return f"{operations:+d}", f"{row.cost.time / study.cost.time - 1.0:+.0%}", _lowest(row.poses)


def _lowest(poses: Iterable[Any]) -> str:
    """Range of the first frequency over start, middle and end of the path."""
    first = [pose.frequencies[0] for pose in poses if pose.frequencies]
    return f"{min(first):.2f}–{max(first):.2f}" if first else "–"


def _check_report(comparisons: Iterable[Comparison]) -> list[RenderableType]:
    """Estimates beside what runs of the FMUs show."""
    table = _table("the chosen set beside richer ones: largest change over the metrics")
    for heading in ("Effect", "Change"):
        table.add_column(heading)
    for heading in ("estimated", "observed", "effectivity", "time of a run"):
        table.add_column(heading, justify="right")
    for each in comparisons:
        estimated, observed = max(each.estimated.values()), max(each.observed.values())
        ratio = "–" if each.effectivity is None else f"{each.effectivity:.2f}"
        numbers = percent(estimated), percent(observed), ratio, f"{each.slower:.2f} x"
        table.add_row(each.effect, each.change, *numbers)
    return [table]


def _table(title: str) -> Table:
    return Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold")
