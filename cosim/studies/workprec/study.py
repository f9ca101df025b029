"""The whole study of a scene: every family of trials, the references that errors are relative to, what they say in a sentence, and
the results as a table for the terminal, Markdown, and plain data.

A work-precision study measures processor time against error for each method over its own settings (Hairer, Norsett and Wanner,
Solving Ordinary Differential Equations I, sec. II.10). Methods are compared at equal errors, between two settings by
interpolation of logarithms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rich.table import Column, Table

from flexfmu.cosim.design.effects.accuracy import Chooser, setting_text, with_numerics
from flexfmu.cosim.design.effects.runs import is_smooth
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.reports.summary import versions
from flexfmu.cosim.reports.terminal import markdown_table, titled_table
from flexfmu.cosim.reports.work_precision import by_line
from flexfmu.cosim.studies.workprec import solver_trials
from flexfmu.cosim.studies.workprec.solver_trials import PAPER_LINE
from flexfmu.cosim.studies.workprec.trial import (
    Announce,
    SceneUnderTest,
    algorithm_settings,
    coupling_settings,
    fmu_trials,
    integrator_settings,
    subject_of,
)
from flexfmu.model.choice_text import set_text
from flexfmu.model.scene.schema import Scene

STEP = 1e-3
"""Communication step at which integrators, tools and effects are compared [s]."""

OURS = "flexfmu"
"""Line of the best of our integrators' settings among other tools."""


@dataclass(frozen=True)
class WorkPrecisionStudy:
    """The results for a scene.

    Attributes:
        scene: what was simulated.
        duration: simulated time [s].
        scale: largest elastic deviation [m]; errors are relative to it.
        agreement: relative difference of two independent references; None where there is only one.
        references: how they were made.
        trials: every measured point.
        floors: metric or family and set of effects → error of the set itself, which no integrator goes below.
        remarks: what wasn't measured and why, a sentence each.
        known: metric → what the richest model itself is known to; smaller errors are of the numerics alone.
    """

    scene: Scene
    duration: float
    scale: float
    agreement: float | None
    references: str
    trials: tuple[WorkPrecisionTrial, ...]
    floors: Mapping[tuple[str, str], float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    known: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_of_metrics(self) -> bool:
        """Whether the families are metrics."""
        return not {*self.families} & {*FAMILIES}

    def is_ladder(self, name: str) -> bool:
        """Whether the lines of a family are sets of effects."""
        return name == EFFECTS or name not in FAMILIES

    @property
    def families(self) -> tuple[str, ...]:
        """The questions that were asked, in their order: of `FAMILIES`, or metrics."""
        return tuple(dict.fromkeys(each.family for each in self.trials))

    def family(self, name: str) -> tuple[WorkPrecisionTrial, ...]:
        """The trials of one family."""
        return tuple(each for each in self.trials if each.family == name)


EFFECTS = "effects"
"""The family of sets of effects."""

FAMILIES = ("integrators", "communication", "algorithms", EFFECTS, "formulations", "tools")
"""Questions that can be asked, in this order."""

EQUATIONS = "communication", "formulations", "tools"
"""Those that only a scene which is one smooth equation has an answer to."""


Peer = Callable[[SceneUnderTest, WorkCurve], Iterator[WorkPrecisionTrial]]
"""Trials of another program, as far as they compare with the curve of our best settings."""


def run_study(
    scene: Scene,
    families: Sequence[str],
    announce: Announce,
    step: float = STEP,
    peers: Sequence[Peer] = (),
    journal: WorkJournal = NOWHERE,
) -> WorkPrecisionStudy:
    """Measure a scene.

    Args:
        scene: the scene.
        families: which of `FAMILIES`; those that a scene has no answer for are left out, with a remark.
        announce: called with what is being tried.
        step: communication step of the comparisons [s].
        peers: other programs for the same robot, which stand among the tools.
        journal: where trials are kept, also from an earlier call for the same scene and step.

    Raises:
        RunError: the reference can't be calculated.
        TrajectoryError, InputError, BuildError: as for `flexfmu.cosim.many.prepared_scene.run_scene`.
    """
    subject = subject_of(scene, announce, journal)
    # the reference, compared with one that shares neither integrator nor master where the scene has one
    announce("reference")
    _ = subject.reference
    agreement, references = None, "our FMU, Gauss collocation at 1e-12, 0.25 ms steps"
    if is_smooth(scene):
        announce("second reference")
        second = solver_trials.independent_reference
        agreement = journal.kept(("second reference",), float, lambda: subject.error(second(subject)))
        references += "; SciPy's DOP853 at 1e-11"
    # families in their order, since later ones use the trials of earlier ones
    trials, floors, remarks = list[WorkPrecisionTrial](), dict[tuple[str, str], float](), list[str]()
    for name in (each for each in FAMILIES if each in families):
        if name in EQUATIONS and not is_smooth(scene):
            remarks.append(f"{name}: left out, a scene with a loop, torques or samples isn't one smooth equation.")
        elif name == "integrators":
            trials += fmu_trials(subject, name, integrator_settings(step))
        elif name == "communication":
            trials += fmu_trials(subject, name, coupling_settings())
        elif name == "algorithms" and not scene.controller:
            remarks.append(f"{name}: left out, there is no controller to couple.")
        elif name == "algorithms":
            trials += fmu_trials(subject, name, algorithm_settings(scene))
        elif name == EFFECTS:
            try:
                ladder = Ladder(scene, [PATH], lambda text, _: announce(text), journal)
                own = step if is_smooth(scene) else scene.cosimulation.communication_step
                found, errors = ladder.trials([(own, "automatic")])
                trials += (replace(each, family=name) for each in found)
                floors |= {(name, line): error for (_, line), error in errors.items()}
                remarks.append(f"{name}: errors of {PATH} beside {ladder.reference}.")
            except CosimError as failure:
                remarks.append(f"{name}: {failure}.")
        elif name == "formulations":
            trials += solver_trials.formulation_trials(subject)
        elif name == "tools":
            # our best settings stand among the tools, measured with the integrators or here
            settings = (each for each in integrator_settings(step) if each[0] == "automatic")
            measured = [each for each in trials if each.family == "integrators"]
            ours = WorkCurve.of(measured or fmu_trials(subject, "integrators", settings))
            trials += (replace(each, family=name, line=OURS, label=f"{each.line} {each.label}") for each in ours.trials)
            # the same equations in other solvers, the paper's setting, and other programs
            trials += solver_trials.scipy_trials(subject, ours)
            trials += solver_trials.sundials_trials(subject, ours)
            trials.append(solver_trials.paper_trial(subject))
            for peer in peers:
                trials += peer(subject, ours)
    return WorkPrecisionStudy(
        scene, subject.stop, subject.scale, agreement, references, tuple(trials), floors, tuple(remarks)
    )


PATH = "peak_position_error"
"""Metric by which sets of effects are compared where none is named."""

STUDIED = 1e-2
"""Accuracy of the metrics of a study: their modes converge to a tenth of it; more precise errors are beside that richest model."""

REACHED = 1.02
"""Ratio to the error of a set of effects below which tighter tolerances change nothing."""

STUDIED_TOLERANCES = tuple(10.0**-k for k in range(1, 11))


ACCURACIES = tuple(10.0**-k for k in range(2, 11))
"""Accuracies for which a study of metrics names the cheapest setting."""


class Ladder:
    """Sets of effects of a scene, over tolerances, communication steps and integrators.

    Errors are beside the richest model at 1e-11, the largest with the scene's payload and 1 % around it, of the scene as it is, loop
    included: that of the set itself at 1e-11, and that of the numerics beside it.

    Args:
        scene: the scene, its effects chosen.
        metrics: names of metrics or of margins.
        show: called with the current activity and the finished fraction.
        journal: where runs are kept, also from an earlier call for the same scene and metrics.

    Raises:
        InputError, ResultsError: as for `flexfmu.cosim.design.effects.accuracy.Chooser`.
    """

    def __init__(
        self, scene: Scene, metrics: Sequence[str], show: ShowProgress = quiet, journal: WorkJournal = NOWHERE
    ) -> None:
        self._fraction: float | None = None
        asked = dict.fromkeys(metrics, STUDIED)
        self._chooser = Chooser(scene, asked, lambda text, _: show(text, self._fraction), journal)
        self._is_smooth = is_smooth(scene)
        self.values = np.abs(np.array(self._chooser.reference.values[0]))

    @property
    def reference(self) -> str:
        """What errors are relative to."""
        known = ", ".join(f"{name} by {error:.1e}" for name, error in self.known.items())
        return (
            f"{set_text(self._chooser.richest)}, at 1e-11; further modes and shorter steps may change {known}: smaller errors are of the "
            "numerics alone"
        )

    @property
    def known(self) -> dict[str, float]:
        """Metric → relative error of the richest model itself."""
        return dict(zip(self._chooser.asked, (self._chooser.known / self.values).tolist(), strict=True))

    def numerics(self) -> list[tuple[float | None, str]]:
        """Communication steps [s] and integrators that are worth a trial."""
        steps = self._chooser.steps() if self._is_smooth else self._chooser.steps()[:2]
        return [(step, name) for step in steps for name in ("automatic", "gauss4")[: None if self._is_smooth else 1]]

    def trials(
        self, numerics: Sequence[tuple[float | None, str]]
    ) -> tuple[list[WorkPrecisionTrial], dict[tuple[str, str], float]]:
        """The points of each set of effects, for each figure, and the errors of the sets themselves by figure and set.

        A line ends at a tolerance that leaves the error of its set alone or the smallest of `ACCURACIES`, after which no shorter steps
        are tried, where that one is cheaper already, and where two tighter tolerances change nothing.
        """
        names, ladder = [*self._chooser.asked], self._chooser.ladder
        found, floors, limit = list[WorkPrecisionTrial](), dict[tuple[str, str], float](), np.inf
        for place, (line, base) in enumerate(ladder.items()):
            shortest = 0.0
            for number, (step, integrator) in enumerate(numerics):
                if step is not None and step < shortest:
                    continue
                self._fraction, before = (place + number / len(numerics)) / len(ladder), [np.inf, np.inf]
                for tolerance in STUDIED_TOLERANCES:
                    setting = with_numerics(base, step, integrator, tolerance)
                    try:
                        trial = self._chooser.measured(setting)
                    except CosimError as failure:
                        label, text = setting_text(setting).partition("; ")[2], " ".join(str(failure).split())
                        found += (WorkPrecisionTrial(each, line, label, None, None, text) for each in names)
                        break
                    found += self._chooser.points(trial)
                    floor = trial.model / self.values
                    floors |= {(name, line): float(error) for name, error in zip(names, floor, strict=True) if error}
                    errors = trial.both / self.values
                    is_fine = (errors <= np.maximum(REACHED * floor, ACCURACIES[-1])).all()
                    if is_fine:
                        shortest = step or 0.0
                    if is_fine and (floor <= ACCURACIES[-1]).all():
                        limit = min(limit, trial.time)
                    if is_fine or trial.time > limit or all((each <= REACHED * errors).all() for each in before):
                        break
                    before = [before[1], errors]
        self._fraction = None
        return sorted(found, key=lambda each: names.index(each.family)), floors


def run_metric_study(
    scene: Scene, metrics: Sequence[str], show: ShowProgress = quiet, journal: WorkJournal = NOWHERE
) -> WorkPrecisionStudy:
    """Measure what accuracy of metrics costs; arguments and errors as for `Ladder`."""
    ladder = Ladder(scene, metrics, show, journal)
    trials, floors = ladder.trials(ladder.numerics())
    duration = scene.trajectory.moving_time + scene.trajectory.dwell
    return WorkPrecisionStudy(scene, duration, 1.0, None, ladder.reference, tuple(trials), floors, known=ladder.known)


def accuracy_rows(study: WorkPrecisionStudy) -> list[tuple[str, ...]]:
    """For each metric and accuracy: the cheapest setting and its time; whether the error is of the numerics alone."""
    rows = list[tuple[str, ...]]()
    for name in study.families:
        for error in ACCURACIES:
            best, cells = cheapest(study.family(name), error), ("–", "", "not reached")
            if best is not None:
                alone = "; numerics alone" if error < study.known.get(name, 0.0) else ""
                cells = f"{1e3 * (best.time or 0.0):.3g}", best.line, f"{best.label}{alone}"
            rows.append((name, f"{error:.0e}", *cells))
    return rows


ACCURACY_COLUMNS: tuple[str, ...] = ("metric", "error", "time ms", "effects", "setting")


ASKED = 1e-5, 1e-3
"""Accuracies that the sentence speaks of."""

COMPARED = 1e-5
"""Error at which other tools are compared, where they reach it."""

CHOICES = ("integrators", "communication")
"""Families between whose settings a user of this FMU chooses."""


def cheapest(trials: Iterable[WorkPrecisionTrial], error: float) -> WorkPrecisionTrial | None:
    """Return the fastest trial with at most this error; None if there is none."""
    good = [each for each in trials if each.error is not None and each.error <= error and each.time is not None]
    return min(good, key=lambda each: each.time or 0.0, default=None)


def sentence(study: WorkPrecisionStudy) -> str:
    """The cost of accuracy on this scene in one sentence."""
    if not {*study.families} & {*CHOICES}:
        found = [(name, cheapest(study.family(name), 1e-3)) for name in study.families if study.is_ladder(name)]
        parts = [
            f"1e-3 of {PATH if name == EFFECTS else name} costs {1e3 * (best.time or 0.0):.2g} ms ({best.line})"
            for name, best in found
            if best is not None
        ]
        return f"{', '.join(parts) or 'No setting reached 1e-3'}."
    # settings that a user of the FMU may choose from
    ours = [each for each in study.trials if each.family in CHOICES]
    first, second = (cheapest(ours, error) for error in ASKED)
    if first is None or first.time is None or second is None:
        return f"No setting reached {ASKED[0]:.0e}."
    text = f"An error of {ASKED[0]:.0e} costs {_cost(first)}, {study.duration / first.time:.0f} times faster than real time"
    return f"{text}; one of {ASKED[1]:.0e} costs {'no less' if second is first else _cost(second)}."


def _cost(trial: WorkPrecisionTrial) -> str:
    """Time and setting of a trial, of which the label has the tolerance or the step."""
    kind = "steps of" if trial.label.endswith("s") else "a tolerance of"
    return f"{1e3 * (trial.time or 0.0):.1f} ms with {trial.line} at {kind} {trial.label}"


def advantages(study: WorkPrecisionStudy) -> dict[str, tuple[float, float]]:
    """Line of another tool → error, `COMPARED` or the nearest one that both have reached, and its processor time for it over ours.

    Times are interpolated on the curves of the best settings.
    """
    tools = study.family("tools")
    # a curve of the best settings for each tool
    curves = {line: WorkCurve.of(each) for line, each in by_line(tools).items()}
    ours, found = curves.pop(OURS, WorkCurve(())), {}
    curves.pop(PAPER_LINE, None)  # our own solver, and the beginning of the motion alone
    for line, curve in curves.items():
        # an error that both have reached, as near to the wanted one as possible
        error = min(max(COMPARED, curve.least, ours.least), curve.most)
        own, theirs = ours.time(error), curve.time(error)
        if own and theirs:
            found[line] = error, theirs / own
    return found


COLUMNS: tuple[str, ...] = ("family", "line", "setting", "error", "time ms", "x real time", "note")

NUMBERS = ("error", "time ms", "x real time")
"""Columns of numbers."""


def terminal_table(study: WorkPrecisionStudy) -> Table:
    """One line for each trial; of metrics, for each accuracy."""
    what, heads = f"errors relative to {1e3 * study.scale:.3g} mm, the largest elastic deviation", COLUMNS
    rows: list[tuple[str, ...]] = [row(study, trial) for trial in study.trials]
    if study.is_of_metrics:
        what, heads, rows = "the cheapest setting for an error of each metric", ACCURACY_COLUMNS, accuracy_rows(study)
    columns = [Column(each, justify="right" if each in NUMBERS else "left") for each in heads]
    table = titled_table(f"{study.scene.name}: {what}", *columns, stacks=study.is_of_metrics)
    for cells in rows:
        table.add_row(*cells)
    return table


def row(study: WorkPrecisionStudy, trial: WorkPrecisionTrial) -> tuple[str, ...]:
    """Cells of a trial's line."""
    if trial.error is None or trial.time is None:
        return (trial.family, trial.line, trial.label, "failed", "", "", trial.note)
    figures = f"{trial.error:.1e}", f"{1e3 * trial.time:.1f}", f"{study.duration / trial.time:.3g}"
    return (trial.family, trial.line, trial.label, *figures, trial.note)


def notes(study: WorkPrecisionStudy) -> list[str]:
    """The notes below the table."""
    found = [sentence(study)]
    agreement = f", which agree within {study.agreement:.1e}" if study.agreement is not None else ""
    found.append(f"References: {study.references}{agreement}.")
    found += study.remarks
    if study.is_of_metrics:
        failed = {(each.line, each.note) for each in study.trials if each.failed}
        return [*found, *(f"{line} fails: {note}" for line, note in sorted(failed))]
    compared = advantages(study)
    for error in sorted({error for error, _ in compared.values()}):
        ratios = [f"{line} {ratio:.0f} times" for line, (at, ratio) in compared.items() if at == error]
        found.append(f"For an error of {error:.1e} other tools take longer than flexfmu: {', '.join(ratios)}.")
    return found


def markdown(study: WorkPrecisionStudy) -> str:
    """Table and notes."""
    tables = {ACCURACY_COLUMNS: accuracy_rows(study)} if study.is_of_metrics else {}
    tables[COLUMNS] = [row(study, trial) for trial in study.trials]
    texts = [
        markdown_table(heads, ["--:" if each in NUMBERS else ":--" for each in heads], rows)
        for heads, rows in tables.items()
    ]
    return "\n\n".join([f"# Work and precision: {study.scene.name}", *notes(study), *texts]) + "\n"


def data(study: WorkPrecisionStudy) -> dict[str, Any]:
    """The study as plain data."""
    found: dict[str, Any] = {
        "scene": study.scene.name,
        "duration": study.duration,
        "scale": study.scale,
        "references": study.references,
        "agreement": study.agreement,
        "sentence": sentence(study),
        "advantages": {line: ratio for line, (_, ratio) in advantages(study).items()},
        "advantage_errors": {line: error for line, (error, _) in advantages(study).items()},
        "trials": [vars(trial) for trial in study.trials],
        "remarks": study.remarks,
        "floors": [{"metric": name, "line": line, "error": error} for (name, line), error in study.floors.items()],
        "versions": versions(),
    }
    if study.is_of_metrics:
        found["accuracies"] = [dict(zip(ACCURACY_COLUMNS, row, strict=True)) for row in accuracy_rows(study)]
    return found
