"""`flexfmu effects`: every effect with what it is worth and what it costs, and the cheapest set within a tolerance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from flexfmu.cosim.choices.effects.search import absent_effects
from flexfmu.cosim.choices.effects.study import (
    Comparison,
    EffectRow,
    EffectStudy,
    check_choice,
    comparison_table,
    contribution_table,
    frequency_table,
    study_effects,
)
from flexfmu.cosim.cli.console import print_rich, print_text, progress
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.reports.summary import choice_summary
from flexfmu.cosim.reports.text import to_json
from flexfmu.model.choice_text import percent, set_text
from flexfmu.model.scene.choice import INTEGRATOR_SHARE, ChoiceSection
from flexfmu.model.scene.file import load_scene


def effects_command(source: str, tolerance: float | None, of: list[str], check: bool, as_json: bool) -> int:
    """Choose the effects of a scene, print what each is worth; the exit status."""
    scene = load_scene(source)
    with progress() as show:
        study = study_effects(scene, tolerance, tuple(of), show)
        comparisons = check_choice(study, show=show) if check else ()
    if as_json:
        print_text(to_json(_as_data(study, comparisons)))
    else:
        print_rich(*_report(study), *([comparison_table(comparisons)] if check else ()))
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
        "absent": absent_effects(study.scene),
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


def _row_data(choice: ChoiceSection, row: EffectRow) -> dict[str, Any]:
    return {
        "effect": row.estimate.effect,
        "change": row.estimate.change,
        "place": row.place,
        "contribution": dict(zip(choice.of, row.estimate.contribution, strict=True)),
        "cost": vars(row.cost),
        "poses": [pose.to_dict() for pose in row.poses],
    }


def _report(study: EffectStudy) -> list[RenderableType]:
    """The tables of all effects, and the choice in words."""
    choice, absent = study.choice, ", ".join(absent_effects(study.scene))
    worst = ", ".join(
        f"{METRICS[name].label.lower()} {percent(value)}" for name, value in zip(choice.of, choice.error, strict=True)
    )
    limit = (1.0 - INTEGRATOR_SHARE) * choice.tolerance
    lines = [
        *([f"the scene has no {absent}: it alone could say how large they are"] if absent else []),
        f"chosen for {percent(choice.tolerance)}: {set_text(study.scene)}",
        f"estimated error of this set: {worst}; it may be {percent(limit)}",
        f"tolerance of the FMU: {study.scene.cosimulation.tolerance:g}",
    ]
    return [contribution_table(study), frequency_table(study), *map(Text, lines)]
