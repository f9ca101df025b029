"""A study as text: a table for the terminal, Markdown, and plain data."""

from __future__ import annotations

from typing import Any

from rich import box
from rich.table import Table

from flexfmu.cosim.reports.versions import versions
from flexfmu.cosim.workprec.conclusions import advantages, sentence
from flexfmu.cosim.workprec.study import Study
from flexfmu.cosim.workprec.trial import Trial

COLUMNS = ("family", "line", "setting", "error", "time ms", "x real time", "note")


def terminal_table(study: Study) -> Table:
    """One line for each trial."""
    title = f"{study.scene.name}: errors relative to {1e3 * study.scale:.3g} mm, what elasticity does"
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold")
    for column in COLUMNS:
        table.add_column(column, justify="right" if column in COLUMNS[3:6] else "left", no_wrap=column != "note")
    for trial in study.trials:
        table.add_row(*row(study, trial))
    return table


def row(study: Study, trial: Trial) -> tuple[str, ...]:
    """Cells of a trial."""
    if trial.error is None or trial.time is None:
        return (trial.family, trial.line, trial.label, "failed", "", "", trial.note)
    factor = study.duration / trial.time
    return (
        trial.family,
        trial.line,
        trial.label,
        f"{trial.error:.1e}",
        f"{1e3 * trial.time:.1f}",
        f"{factor:.3g}",
        trial.note,
    )


def notes(study: Study) -> list[str]:
    """What stands below the table."""
    found = [sentence(study)]
    agreement = f", which agree within {study.agreement:.1e}" if study.agreement is not None else ""
    found.append(f"References: {study.references}{agreement}.")
    compared = advantages(study)
    for error in sorted({each.error for each in compared.values()}):
        ratios = [f"{line} {each.ratio:.0f} times" for line, each in compared.items() if each.error == error]
        found.append(f"For an error of {error:.1e} other tools take longer than flexfmu: {', '.join(ratios)}.")
    return found


def markdown(study: Study) -> str:
    """Table and notes."""
    rule = [":--", ":--", ":--", "--:", "--:", "--:", ":--"]
    rows = [COLUMNS, rule, *(row(study, trial) for trial in study.trials)]
    table = "\n".join("| " + " | ".join(cells) + " |" for cells in rows)
    return "\n\n".join([f"# Work and precision: {study.scene.name}", *notes(study), table]) + "\n"


def data(study: Study) -> dict[str, Any]:
    """Everything for machines."""
    return {
        "scene": study.scene.name,
        "duration": study.duration,
        "scale": study.scale,
        "references": study.references,
        "agreement": study.agreement,
        "sentence": sentence(study),
        "advantages": {line: each.ratio for line, each in advantages(study).items()},
        "advantage_errors": {line: each.error for line, each in advantages(study).items()},
        "trials": [vars(trial) for trial in study.trials],
        "versions": versions(),
    }
