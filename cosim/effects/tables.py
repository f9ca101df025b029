"""An automatic choice of effects as tables: what each effect is worth and costs, frequencies, estimates beside runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rich import box
from rich.table import Table

from flexfmu.cosim.effects.check import Comparison
from flexfmu.cosim.effects.study import EffectRow, EffectStudy
from flexfmu.cosim.measuring.metric_table import METRICS
from flexfmu.cosim.modes_table import ModalPose
from flexfmu.model.selection.words import percent

SHOWN_FREQUENCIES = 3
"""Lowest frequencies of each pose in the table; all of them are in the JSON."""

LONGEST_WORD = len("foreshortening")


def contribution_table(study: EffectStudy) -> Table:
    """Every effect, in or out, with its contribution to each metric and its cost."""
    metrics = [METRICS[name].label for name in study.choice.of]
    table = _table(
        f"{study.scene.name}: what each effect is worth, as relative change of each metric, and what it costs",
        (" ", "Effect", "Change"),
        (*metrics, "states", "operations", "time"),
    )
    cost = study.cost
    own = f"{cost.states}", f"{cost.operations}", f"{1e6 * cost.time:.3g} µs"
    table.add_row("", "the set itself", "", *("" for _ in metrics), *own)
    for row in study.rows:
        states, operations = row.cost.states - cost.states, row.cost.operations - cost.operations
        slower = 100.0 * (row.cost.time / cost.time - 1.0)
        more = f"{states:+d}" if states else "", f"{operations:+d}", f"{slower:+.0f} %"
        table.add_row(*_named(row), *map(percent, row.estimate.contribution), *more)
    return table


def frequency_table(study: EffectStudy) -> Table:
    """Natural frequencies along the path, of the set and with each single change."""
    places = [f"s = {pose.s:g}" for pose in study.poses]
    table = _table(
        f"lowest {SHOWN_FREQUENCIES} natural frequencies along the path [Hz], motors locked",
        (" ", "Effect", "Change"),
        places,
    )
    table.add_row("", "the set itself", "", *_lowest(study.poses))
    for row in study.rows:
        table.add_row(*_named(row), *_lowest(row.poses))
    return table


def comparison_table(comparisons: Iterable[Comparison]) -> Table:
    """Estimates beside what runs of the FMUs show."""
    table = _table(
        "the chosen set beside richer ones: largest change over the metrics",
        ("Effect", "Change"),
        ("estimated", "observed", "effectivity", "time of a run"),
    )
    for each in comparisons:
        estimated, observed = max(each.estimated.values()), max(each.observed.values())
        ratio = "–" if each.effectivity is None else f"{each.effectivity:.2f}"
        table.add_row(each.effect, each.change, percent(estimated), percent(observed), ratio, f"{each.slower:.2f} x")
    return table


def _named(row: EffectRow) -> tuple[str, str, str]:
    return row.place, row.estimate.effect, row.estimate.change


def _lowest(poses: Iterable[ModalPose]) -> Iterator[str]:
    """The lowest frequencies of each pose."""
    for pose in poses:
        yield "  ".join(f"{frequency:.1f}" for frequency in pose.frequencies[:SHOWN_FREQUENCIES]) or "–"


def _table(title: str, texts: Iterable[str], numbers: Iterable[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold")
    for heading in texts:
        table.add_column(heading, no_wrap=heading != "Change", min_width=LONGEST_WORD if heading == "Change" else None)
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table
