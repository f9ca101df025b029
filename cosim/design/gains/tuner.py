"""Tunes gains and other keys of a scene by runs: what minimises a metric within limits.

First the scene's own values and points of a scrambled Sobol sequence over all intervals are tried, by all processors. The best of
them are then improved, by gradients. Equal intervals and seeds try equal values whatever the number of processors, so
that an interrupted tuning continues from its journal.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.design.gains.goals import parse_condition, parse_goal
from flexfmu.cosim.design.gains.robustness import PayloadBand, band_masses
from flexfmu.cosim.design.gains.search import BudgetExceeded, Search, descend_by_gradients
from flexfmu.cosim.design.gains.trial import Interval, Study, Trial, check_keys, trial_journal
from flexfmu.cosim.design.response.response import FrequencyResponse
from flexfmu.cosim.design.scene_files import write_changed, write_new
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import OutputFolder, to_json
from flexfmu.cosim.engine.showing import Rows, ShowProgress, few_lines, quiet, shown_unit
from flexfmu.cosim.experiment.metric import RunMetrics
from flexfmu.cosim.many.executor import mapping
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import LOOP_METRICS, MOTOR_METRICS, definition, metric
from flexfmu.cosim.reports.chart import DASHES, GREY, INK, PALETTE, Curve, Panel, scale_of
from flexfmu.cosim.reports.page import TILES, Page, Plot, Table
from flexfmu.cosim.reports.page import Figure as PageFigure
from flexfmu.cosim.reports.report import of_scene
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.keys import full_key, location, value_at
from flexfmu.model.scene.messages import unit_of
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("gradient", "sample")
"""What follows the first points: a descent by gradients, or further points of the sequence."""

FORMER = {"trust-region": "gradient"}
"""Former method → what is used in its place."""

FIRST, MOST_FIRST = 8, 64
"""First points for one key, twice as many for each further one, and the largest number of them."""

USUAL = 40
"""Trials for each key that follow the first points."""


@dataclass(frozen=True, repr=False)
class TuneResult(Rows):
    """Tuned values.

    Attributes:
        study: what was tuned, and for what.
        given: the scene as it was.
        best: the best trial; the given one if none is better.
        trials: all trials in their order, the given one first.
        interrupted: whether Ctrl-C ended it.
    """

    row_name = "trial"

    study: Study
    given: Trial
    best: Trial
    trials: tuple[Trial, ...] = field(repr=False)
    interrupted: bool = False

    @property
    def is_feasible(self) -> bool:
        """Whether the best trial keeps all limits."""
        return self.study.rank(self.best)[0] == 0

    @property
    def values(self) -> dict[str, float]:
        """Key → tuned value; empty where the given values are the best."""
        return {each.key: value for each, value in zip(self.study.over, self.best.values, strict=False)}

    @property
    def scene(self) -> Scene:
        """The tuned scene."""
        return self.study.changed(self.best.values)

    @property
    def metrics(self) -> RunMetrics:
        """The figures of the best trial: metrics, the worst over the band of payloads, and margins."""
        found = {name: metric(name, value) for name, value in self.best.figures.items()}
        return RunMetrics(f"{self.study.scene.name}, tuned", lambda companions, names: found)

    def rows(self) -> list[dict[str, Any]]:
        """The trials: values of the keys, figures, and a message where one failed."""
        names = list(dict.fromkeys(part for goal in self.study.goals for part in goal.parts))
        keys, given, found = [each.key for each in self.study.over], self.study.given(), list[dict[str, Any]]()
        for number, trial in enumerate(self.trials):
            row = {"trial": number, **dict(zip(keys, trial.values or given, strict=True))}
            row |= {name: trial.figures.get(name) for name in names}
            found.append({**row, "within_limits": self.study.rank(trial)[0] == 0, "message": trial.message})
        return found

    def shown_rows(self) -> list[dict[str, Any]]:
        """The given trial, then the others, the best first."""
        first, *others = self.rows()
        return [first, *sorted(others, key=lambda row: self.study.rank(self.trials[row["trial"]]))]

    def row_units(self) -> Mapping[str, str]:
        """Figure → unit."""
        return {part: goal.unit for goal in self.study.goals for part in goal.parts if goal.unit}

    def plot(self) -> Figure:
        """The figure that is minimised, of each trial, and the best so far."""
        from flexfmu.cosim.reports.figure_style import figure_of

        return figure_of([self._plot()], f"{self.study.scene.name}: {len(self.trials)} trials")

    def _plot(self) -> Plot:
        goal, curves = self.study.minimise, list[Curve]()
        info = definition(goal.parts[0])
        found = [goal.of(each.figures) for each in self.trials]
        values = np.array([nan if each is None else info.displayed(each) for each in found])
        kept = np.array([self.study.rank(each)[0] == 0 for each in self.trials])
        texts = [
            ", ".join(f"{key.key}={value:.5g}" for key, value in zip(self.study.over, each.values, strict=False))
            for each in self.trials
        ]
        for some, name, colour in ((kept, "keeps all limits", PALETTE[0]), (~kept, "misses a limit", INK)):
            places = np.flatnonzero(some & np.isfinite(values))
            notes = [texts[place] or "given" for place in places]
            curves.append(Curve(places.astype(np.float64), values[places], name, colour, 0.0, dot="disc", notes=notes))
        # steps from trial to trial
        best, number = np.fmin.accumulate(np.where(kept, values, np.nan)), np.arange(1.0 * len(values))
        steps = np.repeat(number, 2)[1:], np.repeat(best, 2)[:-1]
        curves.append(Curve(*steps, "best so far", PALETTE[1], is_read=False))
        ends = number[[0, -1]], values[[0, 0]]
        curves.append(Curve(*ends, "given", GREY, 1.0, dashes=DASHES, is_read=False))
        label = f"{goal.label}\n[{info.display_unit}]"
        curves = [each for each in curves if each.x.size]
        panel = Panel(label, curves, logarithmic=scale_of(values), is_function=False)
        return Plot("trials", "Trials", "The figure that is minimised.", (panel,), "trial", 300.0)

    def tables(self) -> list[Table]:
        """The keys, given and tuned; the figure that is minimised and those with limits."""
        study, pair = self.study, (self.given.figures, self.best.figures)
        data, keys = study.scene.model_dump(), list[list[str]]()
        for each, own in zip(study.over, study.given(), strict=True):
            unit = shown_unit(unit_of(location(data, each.key), Scene))
            # both joints may have values of their own
            both = value_at(data, each.key, study.scene.name)
            given = ", ".join(f"{one:.5g}" for one in both) if own is None and isinstance(both, tuple) else own
            values = (given, self.values.get(each.key, given), each.low, each.high)
            cells = ("–" if one is None else one if isinstance(one, str) else f"{one:.5g}" for one in values)
            keys.append([f"{each.key} [{unit}]" if unit else each.key, *cells])
        goal = study.minimise
        figures = [[goal.label, goal.name, *(goal.shown(goal.of(each)) for each in pair), "smallest"]]
        for limited in study.conditions:
            limit = f"{'<' if limited.limit.is_upper else '>'} {limited.goal.shown(limited.limit.limit)}"
            found = (
                PageFigure.said(limited.goal.shown(limited.closest(each)), is_over=limited.is_missed(each))
                for each in pair
            )
            figures.append([limited.goal.label, limited.goal.name, *found, limit])
        band = ", worst over the robots" if study.robots else "" if study.band is None else ", worst over the payloads"
        return [
            Table(f"{study.scene.name}, tuned", ["Key", "Given", "Tuned", "From", "To"], keys),
            Table(f"Figures{band}", ["Figure", "Name", "Given", "Tuned", "Limit"], figures),
        ]

    def page(self) -> str:
        """The page: what the tuning gained, values and limits, and the figure of each trial, as HTML."""
        goal, (keys, figures) = self.study.minimise, self.tables()
        limited = zip(figures.rows[1:], self.study.conditions, strict=True)
        missed = [f"{row[0]} {row[3]}, limit {row[4]}" for row, each in limited if each.is_missed(self.best.figures)]
        misses = f"no trial keeps all limits{': ' if missed else ''}{'; '.join(missed)}"
        verdict = [
            f"{goal.label} {goal.shown(goal.of(self.best.figures))}, given {goal.shown(goal.of(self.given.figures))}; ",
            PageFigure.said("all limits are kept" if self.is_feasible else misses, is_over=not self.is_feasible),
            f" ({len(self.trials)} trials{', interrupted' if self.interrupted else ''}).",
        ]
        tiles = [
            (f"{row[0]}, limit {row[4]}" if k else row[0], [row[2], row[3]])
            for k, row in enumerate(figures.rows[:TILES])
        ]
        tiles += [(row[0], [f"{row[1]} → {row[2]}"]) for row in keys.rows][: TILES - len(tiles)]
        frame = of_scene(self.scene)
        return Page(f"{self.study.scene.name}, tuned", verdict, [self._plot()], [keys, figures], tiles, **frame).html

    def __repr__(self) -> str:
        """Return at most five lines."""
        goal = self.study.minimise
        shown = [goal.shown(goal.of(each.figures)) for each in (self.given, self.best)]
        head = f"Tuned {self.study.scene.name}: {goal.name} {shown[1]} (given {shown[0]}), {len(self.trials)} trials"
        within = "" if self.is_feasible else "; no trial keeps all limits"
        return few_lines(f"{head}{within}", [f"{key} = {value:g}" for key, value in self.values.items()])


@one_blas_thread()
def tune_scene(
    scene: Scene,
    over: Mapping[str, Sequence[float] | str] | Iterable[str],
    minimise: str = "rms_tracking_error",
    subject_to: Sequence[str] = (),
    *,
    payload_band: PayloadBand | None = None,
    robots: Sequence[Mapping[str, float]] = (),
    response: FrequencyResponse | None = None,
    method: str = "gradient",
    trials: int | None = None,
    seed: int = 0,
    processes: int = 1,
    folder: Path | None = None,
    restart: bool = False,
    show: ShowProgress = quiet,
    note: Callable[[str], object] = lambda text: None,
) -> TuneResult:
    """Tune keys of a scene; arguments and errors as for `flexfmu.tune`.

    Args:
        scene: the scene, its effects chosen.
        over: key → (from, to), or texts ``KEY=FROM:TO``.
        minimise, subject_to, payload_band, response, method, trials, seed, processes: as for `flexfmu.tune`.
        robots: parameters of further robots that all figures hold for.
        folder: where trials are kept; None for memory.
        restart: whether the trials of another tuning in the folder are discarded.
        show: is called with what is being done, and the finished fraction.
        note: is called with a sentence if it continues.
    """
    intervals = _intervals(over)
    check_keys(scene, intervals)
    PreparedScene(scene).check_size(companion=False)
    if response is not None:
        response = replace(response, standard_error=None)  # errors of margins take longer than margins
    conditions = tuple(map(parse_condition, subject_to))
    study = Study(scene, intervals, parse_goal(minimise), conditions, payload_band, tuple(robots), response)
    if payload_band is not None:
        band_masses(scene, payload_band)
    _check_figures(study)
    with contextlib.ExitStack() as stack:
        journal = NOWHERE
        if folder is not None:
            stack.enter_context(OutputFolder(folder).claimed())
            journal = trial_journal(folder, study, restart=restart, note=note, total=trials or usual_trials(study)[1])
        return tune_study(
            study, method=method, trials=trials, seed=seed, processes=processes, journal=journal, show=show
        )


def _intervals(over: Mapping[str, Sequence[float] | str] | Iterable[str]) -> tuple[Interval, ...]:
    """Keys with their intervals.

    Raises:
        InputError: there are none, or one has another form.
    """
    pairs: list[tuple[str, Sequence[float] | str]] = [*over.items()] if isinstance(over, Mapping) else []
    for text in () if isinstance(over, Mapping) else over:
        key, sign, ends = text.partition("=")
        if not (sign and key.strip()):
            raise InputError(f"--over takes KEY=FROM:TO, pd.kp=1e3:1e5 for example, got {text!r}")
        pairs.append((key.strip(), ends))
    if not pairs:
        raise InputError("tuning needs keys and intervals: --over pd.kp=1e3:1e5")
    found = []
    for name, interval in pairs:
        try:
            low, high = (float(each) for each in (interval.split(":") if isinstance(interval, str) else interval))
        except (TypeError, ValueError):
            message = f"`{name}` is tuned over an interval FROM:TO of two numbers, got {interval!r}"
            raise InputError(message) from None
        found.append(Interval(name, low, high))
    return tuple(found)


def _check_figures(study: Study) -> None:
    """Check that the robot has the figures.

    Raises:
        InputError: it lacks one.
    """
    scene = study.scene
    for goal in study.goals:
        part = goal.parts[0]
        if scene.cosimulation.drive == "motion" and (part in LOOP_METRICS or goal.is_margin):
            raise InputError(
                f'scene {scene.name} has no {goal.name}: it needs `cosimulation.drive = "torque"` and a controller'
            )
        if scene.motor is None and part in MOTOR_METRICS:
            raise InputError(f"scene {scene.name} has no {goal.name}: it needs a section `[motor]`")
        dwells = part.startswith("residual") or part == "settling_time"
        if dwells and not scene.trajectory.dwell:
            raise InputError(f"scene {scene.name} has no {goal.name}: it needs `trajectory.dwell` above 0 s")


def tune_study(
    study: Study,
    *,
    method: str = "gradient",
    trials: int | None = None,
    seed: int = 0,
    processes: int = 1,
    journal: WorkJournal = NOWHERE,
    show: ShowProgress = quiet,
) -> TuneResult:
    """Try values and return the best ones; after Ctrl-C the best so far.

    Args:
        study: what is tuned, and for what.
        method: what follows the first points.
        trials: number of all trials; None for the usual one by the number of keys.
        seed: of the first points.
        processes: number of processes.
        journal: what was tried before, and where trials are kept.
        show: is called with what is being done.

    Raises:
        InputError: the method is unknown, or there are too few trials.
        ResultsError: all trials failed, or the journal can't be written.
        MissingCompilerError: there is no C compiler.
    """
    from scipy.stats.qmc import Sobol  # takes a third of a second to import

    count, (first, usual) = len(study.over), usual_trials(study)
    total = usual if trials is None else trials
    method = FORMER.get(method, method)
    if method not in METHODS:
        raise InputError(f"there is no method {method!r} of tuning; choose from {', '.join(METHODS)}")
    if total < 2:
        raise InputError(f"tuning needs at least 2 trials, the given values and others, got {total}")
    # the first points of a scrambled Sobol sequence
    number = total - 1 if method == "sample" else min(first, total - 1)
    shares = Sobol(count, seed=seed).random_base2(max(number - 1, 0).bit_length())[:number]
    points = [tuple(each.at(share) for each, share in zip(study.over, row, strict=True)) for row in shares.tolist()]
    with mapping(study.tried, processes) as tried:
        search = Search(study, tried, total, journal, show)
        interrupted = False
        try:
            search.try_all([(), *points])
            if method != "sample":
                descend_by_gradients(search)
        except BudgetExceeded:
            pass
        except KeyboardInterrupt:
            interrupted = True
    if not search.done:
        raise KeyboardInterrupt
    # the best one whose loop is stable about rest, too, which a short run may not show
    done = [*search.done]
    best = min(done, key=study.rank)
    while not interrupted and study.rank(best)[0] < 2 and (reason := study.instability(best)):
        done[done.index(best)] = replace(best, figures={}, message=reason)
        best = min(done, key=study.rank)
    if study.rank(best)[0] == 2 and not interrupted:
        raise ResultsError(f"all {len(done)} trials failed, the first one: {done[0].message}")
    return TuneResult(study, done[0], best, tuple(done), interrupted)


def usual_trials(study: Study) -> tuple[int, int]:
    """Number of first trials, and of all, where the user names none."""
    count = len(study.over)
    first = min(FIRST << (count - 1), MOST_FIRST)
    return first, first + USUAL * count + 1


def summary(result: TuneResult) -> dict[str, Any]:
    """Return the tuning as plain data, in SI units.

    Keys:
        scene: name.
        keys: for each key low, high, given (None where the joints differ) and tuned.
        minimise: name, unit, given and tuned.
        conditions: text, unit, limit, given and tuned of each; None for an infinite margin too.
        robots: parameters of the further robots, where there are some.
        within_limits, interrupted, trials: whether the best trial keeps all limits, whether Ctrl-C ended the tuning, and the number of
            its trials.
    """
    study, given, best = result.study, result.given, result.best

    def figures(of: Callable[[Mapping[str, float | None]], float | None]) -> dict[str, float | None]:
        values = {"given": of(given.figures), "tuned": of(best.figures)}
        return {name: each if each is not None and isfinite(each) else None for name, each in values.items()}

    return {
        "scene": study.scene.name,
        "keys": {
            each.key: {"low": each.low, "high": each.high, "given": own, "tuned": result.values.get(each.key, own)}
            for each, own in zip(study.over, study.given(), strict=True)
        },
        "minimise": {"name": study.minimise.name, "unit": study.minimise.unit, **figures(study.minimise.of)},
        "conditions": [
            {"text": each.text, "unit": each.goal.unit, "limit": each.limit.limit, **figures(each.closest)}
            for each in study.conditions
        ],
        "payload_band": study.band,
        **({"robots": [*study.robots]} if study.robots else {}),
        "within_limits": result.is_feasible,
        "interrupted": result.interrupted,
        "trials": len(result.trials),
    }


def write_tuning(result: TuneResult, folder: Path) -> list[Path]:
    """Write trials and figures into a folder; return the files, ``tune.csv``, ``tune.json`` and ``tune.html``.

    Raises:
        ResultsError: a file can't be written.
    """
    out = OutputFolder(folder)
    out.prepare()
    texts = {"csv": result.to_csv(), "json": to_json(summary(result)), "html": result.page()}
    return [out.write(f"tune.{ending}", text) for ending, text in texts.items()]


def write_tuned(
    result: TuneResult, target: Path, source: str | Path | None = None, changes: Mapping[str, Any] | None = None
) -> Path:
    """Write the tuned scene.

    Args:
        result: the tuning.
        target: the new file.
        source: the scene file, whose comments stay; None for a file without comments.
        changes: dotted key → value that the scene differed from the file in.

    Raises:
        ResultsError: the file can't be written.
        SceneError: the file doesn't give the scene that was tuned.
    """
    if source is None:
        return write_new(result.scene, target)
    # tuned keys with their whole values: one number for both joints, or both
    data, tuned = result.scene.model_dump(mode="json", exclude_none=True), dict[str, Any]()
    for key in result.values:
        whole = full_key(data, key)
        whole = whole.rpartition("[")[0] if whole.endswith("]") else whole
        value = value_at(data, whole)
        same = isinstance(value, list) and len(value) == 2 and value[0] == value[1]
        tuned[whole] = value[0] if same else value
    return write_changed(source, target, {**(changes or {}), **tuned})
