"""A study as text: a table for the terminal, Markdown, and plain data."""

from __future__ import annotations

from typing import Any

from rich.table import Column, Table

from flexfmu.cosim.reports.summary import versions
from flexfmu.cosim.reports.text import markdown_table, titled_table
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy, advantages, sentence
from flexfmu.cosim.studies.workprec.trial import Trial

COLUMNS = ("family", "line", "setting", "error", "time ms", "x real time", "note")


def terminal_table(study: WorkPrecisionStudy) -> Table:
    """One line for each trial."""
    title = f"{study.scene.name}: errors relative to {1e3 * study.scale:.3g} mm, what elasticity does"
    words = [Column(each, no_wrap=True) for each in COLUMNS[:3]]
    figures = [Column(each, justify="right", no_wrap=True) for each in COLUMNS[3:6]]
    table = titled_table(title, *words, *figures, *COLUMNS[6:])
    for trial in study.trials:
        table.add_row(*row(study, trial))
    return table


def row(study: WorkPrecisionStudy, trial: Trial) -> tuple[str, ...]:
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


def notes(study: WorkPrecisionStudy) -> list[str]:
    """What stands below the table."""
    found = [sentence(study)]
    agreement = f", which agree within {study.agreement:.1e}" if study.agreement is not None else ""
    found.append(f"References: {study.references}{agreement}.")
    compared = advantages(study)
    for error in sorted({each.error for each in compared.values()}):
        ratios = [f"{line} {each.ratio:.0f} times" for line, each in compared.items() if each.error == error]
        found.append(f"For an error of {error:.1e} other tools take longer than flexfmu: {', '.join(ratios)}.")
    return found


def markdown(study: WorkPrecisionStudy) -> str:
    """Table and notes."""
    rule = [":--", ":--", ":--", "--:", "--:", "--:", ":--"]
    table = markdown_table(COLUMNS, rule, [row(study, trial) for trial in study.trials])
    return "\n\n".join([f"# Work and precision: {study.scene.name}", *notes(study), table]) + "\n"


def data(study: WorkPrecisionStudy) -> dict[str, Any]:
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
