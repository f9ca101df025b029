"""Parameters of a scene, or of anybody's FMU, from measurements."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from flexfmu.cosim.design.identification.estimate import (
    BLOCKS,
    NUISANCES,
    FreeParameter,
    Problem,
    Solution,
    undetermined,
)
from flexfmu.cosim.design.identification.measurements import (
    REALS,
    Channel,
    Experiment,
    fmu_experiment,
    is_table,
    scene_experiment,
    table_experiment,
)
from flexfmu.cosim.design.identification.noise import ColouredNoise, independence, whiteness
from flexfmu.cosim.design.identification.result import (
    UNLIKELY,
    Estimated,
    Explanation,
    FittedSignal,
    Identification,
    joined,
)
from flexfmu.cosim.design.identification.spectra import as_spectrum, delay_of_response, spectrum_experiment
from flexfmu.cosim.design.response.response import FrequencyResponse
from flexfmu.cosim.engine.errors import DataWarning, InputError, suggestion
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.variables import settings
from flexfmu.cosim.engine.measured import Log, Mapped, TimedValues, estimate_delay
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.parameters import scene_changes, scene_values
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.keys import parse_setting, split_values
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

UNLIKE, HARDLY = 8.0, 0.5
"""Ratio of measured to simulated sizes, and correlation, beyond which a log isn't one of this robot in these units."""

LAGS = 8
"""Samples to both sides that residuals are compared with the motion over."""

FAST = 0.05
"""Rate of change of a signal, relative to its largest, above which it moves."""

RINGING, NARROW = 0.05, 5.0
"""Largest damping ratio of what rings in residuals, and periods that it must last within a log."""

MANY_PER_START = 8
"""Starts whose first costs are compared, for each that is followed to its minimum."""

SPREAD = 2.0
"""Factor of first values to both sides, of parameters without bounds."""

LEAST_ERROR = 1e-150
"""Standard error of what isn't determined, a held signal's delay for example."""

EXTREME = 6.0
"""Whitened residual that counts as an outlier."""

LOSSES: Mapping[str, Literal["linear", "soft_l1"]] = {"linear": "linear", "robust": "soft_l1"}
"""Name of a loss → SciPy's."""


@dataclass(frozen=True)
class LogSource:
    """A log, and what of the scene belongs to it alone.

    Attributes:
        log: a file, a data frame or a recording.
        changes: key of the scene → value, the payload for example.
    """

    log: Log
    changes: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name for tables and messages."""
        return Path(self.log).name if isinstance(self.log, str | Path) else "the measurement"


def parse_free(text: str) -> tuple[str, float | None, float, float]:
    """Return key, first value and bounds of ``KEY``, ``KEY=START`` or ``KEY=FROM:TO``.

    Raises:
        InputError: the text has another form.
    """
    key, equals, value = text.partition("=")
    try:
        numbers = [float(each) for each in value.split(":")] if equals else []
    except ValueError:
        numbers = [math.nan]
    if not key.strip() or len(numbers) > 2 or not all(map(math.isfinite, numbers)):
        raise InputError(
            f"a free parameter is KEY, KEY=START or KEY=FROM:TO, payload.mass=3:9 for example, got {text!r}"
        )
    if len(numbers) < 2:
        return key.strip(), numbers[0] if numbers else None, -math.inf, math.inf
    if numbers[0] >= numbers[1]:
        remedy = f"{numbers[1]:g}:{numbers[0]:g}" if numbers[0] > numbers[1] else f"{numbers[0]:g} for a first value"
        raise InputError(f"{key}: bounds must ascend, got {value}: write {key}={remedy}")
    return key.strip(), None, numbers[0], numbers[1]


def parse_prior(text: str) -> tuple[str, tuple[float, float]]:
    """Return key, mean and standard deviation of ``KEY=VALUE+-DEVIATION``.

    Raises:
        InputError: the text has another form.
    """
    key, _, value = text.partition("=")
    try:
        mean, deviation = (float(each) for each in value.replace("±", "+-").split("+-"))
    except ValueError:
        mean, deviation = math.nan, math.nan
    if not (key.strip() and math.isfinite(mean) and 0.0 < deviation < math.inf):
        raise InputError(f"a prior is KEY=VALUE+-DEVIATION, payload.mass=6+-0.5 for example, got {text!r}")
    return key.strip(), (mean, deviation)


def parse_log(text: str) -> LogSource:
    """Return the log of ``LOG.csv`` or ``LOG.csv:KEY=VALUE,KEY=VALUE``.

    Raises:
        InputError: there is no such file, or the text has another form.
    """
    path, colon, changes = text.rpartition(":")
    if not colon or Path(text).exists() or not Path(path).exists():
        path, changes = text, ""
    if Path(path).is_dir():
        raise InputError(f"{path} is a folder: name the logs in it")
    if not Path(path).exists():
        raise InputError(f"there is no log {path}")
    return LogSource(path, dict(parse_setting(each) for each in split_values(changes, path)) if changes else {})


def parse_sensors(text: str | None, usual: Collection[str]) -> Collection[str]:
    """What is unknown of sensors, from names with commas; ``none`` for nothing.

    Raises:
        InputError: ``none`` is one of several.
    """
    if text is None:
        return usual
    names = [each.strip() for each in text.split(",")]
    if "none" in names and len(names) > 1:
        raise InputError(f"none stands alone, got {text!r}: leave it out, or the others")
    return () if names == ["none"] else names


Free = Iterable[str] | Mapping[str, float | tuple[float, float]]
"""Keys, as texts for `parse_free`; or key → first value, or bounds."""


def _free_texts(free: Free) -> list[str]:
    if isinstance(free, str):
        return [each for each in free.split(",") if each.strip()]
    if not isinstance(free, Mapping):
        return [*free]
    return [
        f"{key}={':'.join(map(repr, value)) if isinstance(value, tuple) else repr(value)}"
        for key, value in free.items()
    ]


@dataclass(frozen=True)
class Estimation:
    """What is estimated from logs, and how.

    Attributes:
        free: names of an FMU's parameters; keys of a scene without the names of the sections `mechanism` and `effects`, or with them.
        sensors: what is unknown of them: `delay`, `offset`, `gain`.
        mapping: column of the logs → what it is.
        priors: key → mean and standard deviation of what is known beforehand.
        loss: `linear`, or `robust` against outliers.
        starts: number of first values from which the least squares are looked for; more than one are drawn within the bounds.
        seed: of these.
        segments: intervals of the logs' times whose samples count [s]; none for all.
        strict: whether a value in a log that is no finite number is an error instead of left out.
        show: called with what is being done, and the finished fraction.
    """

    free: Free
    sensors: Collection[str]
    mapping: Mapping[str, Mapped]
    priors: Mapping[str, tuple[float, float]]
    loss: str
    starts: int
    seed: int
    segments: Sequence[tuple[float, float]]
    strict: bool
    show: ShowProgress


@one_blas_thread()
def identify_scene(
    scene: Scene, logs: Sequence[LogSource], wanted: Estimation, explain: bool | None = None
) -> Identification:
    """Estimate parameters of a scene from logs.

    Args:
        scene: the scene, with first values.
        logs: at least one.
        wanted: what is estimated.
        explain: whether effects that the scene lacks are tried; None for where the residuals aren't noise, or several parameters are free,
            which can imitate what is missing.

    Raises:
        InputError: a key or a log can't be used, or the log isn't one of this robot; the message says why.
        SceneError: a first value is out of range.
        BuildError: the FMU can't be built.
        ResultsError: a simulation failed.
    """
    known, meaning = scene_values(scene), wanted.mapping
    spectra = [None if is_table(each.log) else as_spectrum(each.log, meaning) for each in logs]
    # a column that a response has needn't be in logs
    spectral = {
        name for each in spectra if isinstance(each, FrequencyResponse) for name in (*each.inputs, *each.outputs)
    }
    columns = {column: each for column, each in meaning.items() if column not in spectral}
    base, parameters = free_parameters(scene, wanted.free, wanted.priors, wanted.show)
    with TemporaryDirectory() as folder:

        def prepared(extra: Mapping[str, Any]) -> list[Experiment]:
            found = []
            for each, measured in zip(logs, spectra, strict=True):
                changes = {key: value for key, value in each.changes.items() if measured is None or key != "pose"}
                robot = base.replace({**changes, **extra}) if changes or extra else base
                if is_table(each.log):
                    found.append(table_experiment(robot, Path(str(each.log)), each.name))
                    continue
                if measured is not None:
                    experiment = spectrum_experiment(robot, measured, meaning, each.changes.get("pose"), name=each.name)
                else:
                    experiment = scene_experiment(
                        robot,
                        build_scene(robot, shared=True).path,
                        each.log,
                        columns,
                        folder,
                        wanted.segments,
                        name=each.name,
                        strict=wanted.strict,
                    )
                # what is known of one log isn't free there
                fixed = {
                    p.name: scene_values(robot)[p.name].value for p in parameters if p.name in map(_short, changes)
                }
                found.append(
                    replace(experiment, simulate=partial(_with_fixed, experiment, fixed)) if fixed else experiment
                )
            return found

        study = _Study(scene.name, prepared({}), parameters, wanted)
        solved = study.solved()
        signals = study.signals(solved)
        explanations = study.explanations(solved, signals, base, prepared, explain)
    found = study.result(solved, signals, explanations)
    changes = scene_changes(base, found.values)
    keyed = tuple(replace(each, key=known[each.name].key) for each in found.estimates)
    return replace(found, estimates=keyed, scene=base.replace(changes), changes=changes)


def free_parameters(
    scene: Scene, free: Free, priors: Mapping[str, tuple[float, float]], show: ShowProgress = quiet
) -> tuple[Scene, list[FreeParameter]]:
    """The scene with the first values, and the parameters to be estimated; arguments as in `Estimation`, errors as for `identify_scene`."""
    known = scene_values(scene)
    own = {name: each.value for name, each in known.items() if not name.startswith("start.")}
    chosen = _chosen(free, priors, own, scene.name, _short)
    # effects that the scene lacks; of others the controllers' models keep the scene's values
    changes = {known[each.name].key: each.start for each in chosen if own[each.name] == 0.0 != each.start}
    base = scene.replace(changes) if changes else scene
    show("building the robot", None)
    variables = {each.name: each for each in open_fmu(build_scene(base, shared=True).path).description.modelVariables}
    if unknown := next((each.name for each in chosen if each.name not in variables), None):
        raise InputError(
            f"{known[unknown].key} has no influence on scene {scene.name}: give the effect that it belongs to a value, or leave it out"
        )
    return base, [_of_variable(each, variables[each.name]) for each in chosen]


def _of_variable(parameter: FreeParameter, variable: Any) -> FreeParameter:
    """A parameter with the unit of an FMU's variable, and within its limits.

    Raises:
        InputError: a first value that was given isn't.
    """
    if -parameter.low == parameter.high == math.inf:
        settings({parameter.name: variable}, {parameter.name: parameter.start})
    low = parameter.low if variable.min is None else max(parameter.low, float(variable.min))
    high = parameter.high if variable.max is None else min(parameter.high, float(variable.max))
    start, *drawn = np.clip([parameter.start, *parameter.drawn], low, high).tolist()
    return replace(parameter, unit=variable.unit or "1", start=start, low=low, high=high, drawn=(drawn[0], drawn[1]))


@one_blas_thread()
def identify_fmu(
    path: Path, logs: Sequence[LogSource], wanted: Estimation, step: float | None = None, tolerance: float | None = None
) -> Identification:
    """Estimate parameters, or start values, of anybody's FMU from logs whose columns are its inputs and outputs.

    Args:
        path: of the FMU; its start values are the first ones.
        logs: at least one.
        wanted: what is estimated.
        step: communication step [s]; None for the FMU's own, at most the samples' distance.
        tolerance: relative tolerance; None for the FMU's own.

    Raises: as for `identify_scene`.
    """
    variables = {each.name: each for each in open_fmu(path).description.modelVariables}
    own = {
        name: float(each.start)
        for name, each in variables.items()
        if each.start is not None and each.causality != "input" and each.type in REALS
    }
    chosen = _chosen(wanted.free, wanted.priors, own, path.name)
    parameters = [_of_variable(each, variables[each.name]) for each in chosen]
    if changed := next((each for each in logs if each.changes), None):
        raise InputError(f"{changed.name}: keys of a scene can't be given for an FMU")
    options: dict[str, Any] = {"step": step, "tolerance": tolerance, "strict": wanted.strict}
    experiments = [
        fmu_experiment(path, each.log, wanted.mapping, wanted.segments, name=each.name, **options) for each in logs
    ]
    study = _Study(path.stem, experiments, parameters, wanted)
    solved = study.solved()
    return study.result(solved, study.signals(solved), ())


def _short(key: str) -> str:
    """Name of a key's parameter in the FMU."""
    return key.removeprefix("mechanism.").removeprefix("effects.")


def _chosen(
    free: Free,
    priors: Mapping[str, tuple[float, float]],
    known: Mapping[str, float],
    model: str,
    short: Callable[[str], str] = str,
) -> list[FreeParameter]:
    """The parameters to be estimated, without units.

    Args:
        free, priors: as in `Estimation`.
        known: name of a parameter → its value.
        model: name of scene or FMU.
        short: key → name.

    Raises:
        InputError: a key doesn't exist, is there twice, or has no first value; or a prior is for none of them.
    """
    found, given = list[FreeParameter](), {short(key): each for key, each in priors.items()}
    for text in _free_texts(free):
        key, start, low, high = parse_free(text)
        name = short(key)
        if name not in known:
            raise InputError(
                f"{key} can't be estimated: no parameter of {model} has that name; {suggestion(name, known)}"
            )
        if start is None:
            start = known[name] if low <= known[name] <= high else 0.5 * (low + high)
            start = 0.5 * (low + high) if start == 0.0 and high < math.inf else start
        if start == 0.0 and high == math.inf:
            raise InputError(f"{key} is 0 in {model}: give a first value, {key}=0.01 for example")
        ends = start / SPREAD, start * SPREAD
        drawn = (low, high) if high < math.inf else (min(ends), max(ends))
        found.append(FreeParameter(name, "", start, low, high, given.get(name), drawn))
    names = [each.name for each in found]
    if not names:
        raise InputError("nothing is free: name at least one parameter")
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{twice} is free twice: name it once")
    if unknown := given.keys() - set(names):
        raise InputError(f"the prior of {min(unknown)} is for no free parameter: name it in --free, too")
    return found


@dataclass(frozen=True, eq=False)
class _Solved:
    """A fit, what was kept at its first value and why, and how the starts ended."""

    problem: Problem
    solution: Solution
    kept: Mapping[str, str]
    messages: tuple[str, ...]


class _Study:
    """The least squares of experiments with each other, first values and tests included.

    Args:
        name: of the scene or FMU.
        experiments: at least one.
        parameters: what is estimated.
        wanted: how.

    Raises:
        InputError: an argument is none of its choices, or a log isn't one of this robot.
    """

    def __init__(
        self, name: str, experiments: Sequence[Experiment], parameters: Sequence[FreeParameter], wanted: Estimation
    ) -> None:
        sensors, loss, show = wanted.sensors, wanted.loss, wanted.show
        if not experiments:
            raise InputError("there is no log: give at least one")
        if unknown := [each for each in sensors if each not in NUISANCES]:
            raise InputError(f"{unknown[0]!r} isn't known of sensors; {suggestion(unknown[0], NUISANCES)}")
        if loss not in LOSSES:
            raise InputError(f"there is no loss {loss!r}; {suggestion(loss, LOSSES)}")
        if not 1 <= wanted.starts <= 1000:
            raise InputError(f"the number of starts goes from 1 to 1000, got {wanted.starts}")
        self._name, self._experiments, self._parameters, self._show = name, experiments, parameters, show
        self._sensors, self._loss, self._wanted, self._runs = tuple(sensors), LOSSES[loss], wanted, 0
        show("simulating with the first values", None)
        start = {each.name: each.start for each in parameters}
        self._first = [each.simulate([start])[0] for each in experiments]
        self._delays = [
            delay_of_response(each, run) if "delay" in sensors and each.is_response else _first_delay(each, run)
            for each, run in zip(experiments, self._first, strict=True)
        ]
        for each, run, delay in zip(experiments, self._first, self._delays, strict=True):
            _check_likeness(each, run, delay, name)

    def _problem(self, parameters: Sequence[FreeParameter], fixed: Mapping[str, float]) -> Problem:
        """The problem with some parameters at fixed values."""
        before = self._runs

        def show(runs: int) -> None:
            self._runs = before + runs
            self._show(f"least squares, {self._runs} runs", None)

        experiments = [replace(each, simulate=partial(_with_fixed, each, fixed)) for each in self._experiments]
        starts = [
            FreeParameter(name, "m", value, prior=(value, deviation), experiment=number)
            for number, each in enumerate(experiments)
            for name, (value, deviation) in each.start.items()
        ]
        return Problem(experiments, [*parameters, *starts], self._sensors, self._delays, self._loss, show)

    def solved(self) -> _Solved:
        """Fit, and fit again without what the data don't determine."""
        parameters, kept, messages = [*self._parameters], dict[str, str](), list[str]()
        while True:
            problem = self._problem(
                parameters, {each.name: each.start for each in self._parameters if each.name in kept}
            )
            solution = problem.solve()
            if self._wanted.starts > 1:
                solution, message = self._from_several(problem, solution)
                messages[:] = [message]
            unclear = undetermined(problem, solution)
            if not unclear:
                return _Solved(problem, solution, kept, tuple(messages))
            place, others = next(iter(unclear.items()))
            worst = parameters[place]
            told = joined([parameters[i].name for i in others])
            kept[worst.name] = f"can't be told apart from {told}" if told else "has no influence on what was measured"
            del parameters[place]
            if not parameters:
                raise InputError(
                    f"the logs don't determine {joined([each.name for each in self._parameters])}: {kept[worst.name]}; take another motion (--design) or signal"
                )

    def _from_several(self, problem: Problem, first: Solution) -> tuple[Solution, str]:
        """The best of fits from several first values, and how many of them agree with it."""
        from scipy.stats import qmc

        count, starts, rng = problem.shared, self._wanted.starts, np.random.default_rng(self._wanted.seed)
        points = qmc.LatinHypercube(count, rng=rng).random(MANY_PER_START * (starts - 1))
        ends = np.array([each.drawn for each in problem.free[:count]])
        drawn = [np.append(row, problem.start[count:]) for row in ends[:, 0] + points * (ends[:, 1] - ends[:, 0])]
        # far from the minimum, whitened residuals have minima of their own
        plain, noises = problem.first_noises(problem.start), problem.noises(first)
        costs = [cost for cost, _ in problem.costs(drawn, plain)]
        found = [first]
        for number, place in enumerate(np.argsort(costs)[: starts - 1].tolist()):
            self._show(f"start {number + 2} of {starts}", (number + 1) / starts)
            found.append(problem.fit(problem.fit(drawn[place], plain).unknowns, noises))
        best = min(found, key=lambda each: problem.costs([each.unknowns], noises)[0][0])
        errors = np.sqrt(np.diag(best.covariance))[:count]
        agreeing = sum(bool(np.all(np.abs(each.unknowns - best.unknowns)[:count] <= errors)) for each in found)
        return problem.solve(best.unknowns), f"{agreeing} of {starts} starts end at the same values."

    def explanations(
        self, solved: _Solved, signals: Sequence[FittedSignal], scene: Scene, prepared: Any, wanted: bool | None
    ) -> tuple[Explanation, ...] | None:
        """Effects that the scene lacks and that would explain residuals, the best first.

        Args:
            solved: the fit.
            signals: of the fit.
            scene: the scene of all logs.
            prepared: changes of the scene → experiments.
            wanted: whether they are tried; None for where the residuals depend on the motion, or several parameters are free.

        Returns:
            None where they aren't tried.
        """
        if wanted is None:
            wanted = solved.problem.shared > 1 or not all(each.is_explained for each in signals)
        if not wanted:
            return None
        problem, solution = solved.problem, solved.solution
        from scipy.special import stdtr

        kept = {each.name: each.start for each in self._parameters if each.name in solved.kept}
        scaled = solution.jacobian * problem.sizes
        inverse = np.linalg.pinv(scaled, rcond=1e-10)
        found = list[Explanation]()
        candidates = [
            *_candidates(scene, [each.channel.values for each in problem.rows if each.channel.kind == "torque"])
        ]
        for number, (label, changes) in enumerate(candidates):
            self._show(f"trying {label}", number / len(candidates))
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", DataWarning)
                    richer = prepared(changes)
                recordings = [
                    each.simulate([problem.variant(solution.unknowns, place) | kept])[0]
                    for place, each in enumerate(richer)
                ]
            except (InputError, TrajectoryError, ArithmeticError):
                continue
            own = solution.simulated
            parts = [
                problem.simulated(row, recordings[row.experiment], solution.unknowns)[0] - y
                for row, y in zip(problem.rows, own, strict=True)
            ]
            change = np.concatenate(
                [problem.whitened(parts, solution.noises), np.zeros(solution.white.size - problem.samples)]
            )
            # what the parameters can't do themselves
            beyond = change - scaled @ (inverse @ change)
            size = float(beyond @ beyond)
            if size <= 1e-12 * max(float(change @ change), 1e-300):
                continue
            factor = float(beyond @ solution.white) / size
            share = factor**2 * size / solution.cost
            if factor <= 0.0:
                continue
            left = max(1.0 - share, 1e-12)
            probability = 2.0 * float(stdtr(solution.freedom, -math.sqrt(share / left * solution.freedom)))
            # with the whole effect, or as much of it as the residuals ask for
            shifts = -max(factor, 1.0) * problem.sizes * (inverse @ change)
            named = {each.name: float(x) for each, x in zip(problem.free[: problem.shared], shifts, strict=False)}
            found.append(Explanation(label, changes, share, probability, named))
        return tuple(sorted((each for each in found if each.probability < UNLIKELY), key=lambda each: -each.share))

    def signals(self, solved: _Solved) -> tuple[FittedSignal, ...]:
        """The measured signals beside the simulated ones, and what their residuals tell."""
        from scipy.special import fdtrc

        problem, solution, found = solved.problem, solved.solution, list[FittedSignal]()
        share = len(solution.unknowns) / max(len(problem.rows), 1)
        parts = problem.rows, problem.parts, solution.noises, solution.residuals, solution.simulated
        for row, place, noise, residual, after in zip(*parts, strict=True):
            channel, white = row.channel, solution.white[place]
            before, _ = channel.simulated(self._first[row.experiment], self._delays[row.experiment])
            rate = np.zeros(after.size) if channel.part is not None else np.abs(np.gradient(after, channel.time))
            moves = rate > FAST * rate.max(initial=0.0)
            moving = 1.0
            if min(np.count_nonzero(moves), np.count_nonzero(~moves)) > 10:
                powers = [float(np.mean(white[each] ** 2)) for each in (moves, ~moves)]
                moving = math.sqrt(powers[0] / max(powers[1], 1e-300))
                if fdtrc(np.count_nonzero(moves), np.count_nonzero(~moves), moving**2) > UNLIKELY:
                    moving = min(moving, 1.0)
            # the signal itself at several lags, and the motion
            inputs, motion = _lagged(after, channel), self._experiments[row.experiment].motion
            if motion is not None:
                delay = self._delays[row.experiment] if row.delay is None else float(solution.unknowns[row.delay])
                inputs = np.hstack([inputs, motion(channel.time - delay)])
            independent = independence(white, noise.whitened(inputs, channel.pieces), round(share))
            found.append(
                FittedSignal(
                    log=self._experiments[row.experiment].name,
                    name=channel.name,
                    unit=channel.unit,
                    time=channel.time,
                    measured=channel.values,
                    before=before,
                    after=after,
                    noise=float(np.std(residual)),
                    order=noise.order,
                    whiteness=whiteness(white, channel.pieces),
                    independence=independent,
                    moving=moving,
                    ringing=None if channel.part is not None else _ringing(noise, float(np.ptp(channel.time))),
                    axis=channel.axis,
                )
            )
        return tuple(found)

    def result(
        self, solved: _Solved, signals: Sequence[FittedSignal], explanations: Sequence[Explanation] | None
    ) -> Identification:
        """The values with their intervals, and what there is to say; None for effects that weren't looked for."""
        from scipy.special import stdtrit

        problem, solution, count = solved.problem, solved.solution, solved.problem.shared
        self._show("intervals", None)
        intervals, profiled = problem.intervals(solution)
        ends, x, own = np.array(intervals), solution.unknowns[:, None], np.sqrt(np.diag(solution.covariance))
        # noise of what drives the simulation isn't in the residuals alone
        errors = np.sqrt(np.diag(solution.covariance + problem.driven(solution)))
        ends = x + (errors / np.maximum(own, LEAST_ERROR))[:, None] * (ends - x)
        is_wrong = bool(explanations) or not all(each.is_explained for each in signals)
        messages = [*self._messages(solved, signals, explanations or ())]
        if explanations is None and not is_wrong:
            messages.append(
                "Effects that the scene lacks weren't tried on the residuals: --explain (explain=True) does."
            )
        if is_wrong:
            # what a wrong model does to the estimates differs from part to part of the logs
            apart = problem.jackknife(solution)
            errors = np.maximum(errors, apart)
            width = float(stdtrit(BLOCKS - 1, 0.975)) * apart[:, None]
            ends = np.hstack([np.minimum(ends[:, :1], x - width), np.maximum(ends[:, 1:], x + width)])
        found, shifts = dict[str, Estimated](), explanations[0].shifts if explanations else {}
        for j, (name, each) in enumerate(zip(problem.labels, problem.unknowns, strict=True)):
            # a model that explains more has other values: its interval counts as well
            (low, high), shift = ends[j].tolist(), shifts.get(name, 0.0)
            interval = max(low + min(shift, 0.0), each.low), min(high + max(shift, 0.0), each.high)
            value, error = float(solution.unknowns[j]), float(errors[j])
            found[name] = Estimated(name, each.unit, each.start, value, error, interval, profiled=j in profiled)
        for name, reason in solved.kept.items():
            each = next(each for each in self._parameters if each.name == name)
            found[name] = Estimated(name, each.unit, each.start, each.start, math.nan, (each.start,) * 2, kept=reason)
        wider = errors / np.maximum(own, LEAST_ERROR)
        covariance = (solution.covariance * np.outer(wider, wider))[:count, :count]
        return Identification(
            self._name,
            tuple(found[each.name] for each in self._parameters),
            tuple(found[name] for name in problem.labels[count:]),
            covariance,
            tuple(signals),
            tuple(explanations or ()),
            tuple(messages),
            self._runs,
        )

    def _messages(
        self, solved: _Solved, signals: Sequence[FittedSignal], explanations: Sequence[Explanation]
    ) -> Iterable[str]:
        yield from solved.messages
        for name, reason in solved.kept.items():
            yield f"{name} {reason}: it stays at its first value."
        for j, each in enumerate(solved.problem.free):
            if solved.solution.unknowns[j] in (each.low, each.high):
                yield f"{each.name} ends at its bound, {solved.solution.unknowns[j]:g} {each.unit}."
        unlike = [each for each in signals if not each.is_explained]
        for signal in unlike:
            rings = "" if signal.ringing is None else f", and ring at {signal.ringing:.4g} Hz"
            yield f"The residuals of {signal.name} of {signal.log} depend on the motion{rings}: the model lacks something."
        if explanations:
            best = explanations[0]
            yield (
                f"The scene lacks an effect: {best.label} would explain {100.0 * best.share:.3g} % of the whitened residuals, which isn't "
                "chance; the intervals contain the estimates with it."
            )
        elif unlike and self._experiments[0].scene is not None:
            yield "No effect that was tried would explain them; the intervals are as wide as the estimates from parts of the logs differ."
        outliers = int(np.count_nonzero(np.abs(solved.solution.white) > EXTREME))
        if outliers and self._loss == "linear":
            yield f"{outliers} residuals exceed {EXTREME:g} standard deviations: a robust loss gives them less weight."


def _with_fixed(
    experiment: Experiment, fixed: Mapping[str, float], variants: Sequence[Mapping[str, float]]
) -> list[Recording]:
    """Recordings of variants that have some parameters in common."""
    return experiment.simulate([{**variant, **fixed} for variant in variants])


def _lagged(signal: RealArray, channel: Channel) -> RealArray:
    """A signal at several lags (N, 2 `LAGS` + 1), constant beyond the ends."""
    places = np.arange(signal.size)
    return np.column_stack([signal[np.clip(places + lag, 0, signal.size - 1)] for lag in range(-LAGS, LAGS + 1)])


def _ringing(noise: ColouredNoise, duration: float) -> float | None:
    """Frequency of the least damped pair of poles of a noise's model, where it rings for long [Hz]."""
    able = ((f, damping) for f, damping in noise.resonances if f * duration > NARROW and f < 0.4 / noise.step)
    return next((f for f, damping in able if damping < RINGING), None)


def _first_delay(experiment: Experiment, run: Recording) -> float:
    """First delay of a log's signals [s]."""
    if experiment.has_clock:
        return 0.0
    pairs = []
    for each in experiment.channels:
        simulated, _ = replace(each, time=run.time).simulated(run, 0.0)
        pairs.append((TimedValues(each.time, each.values), TimedValues(run.time, simulated)))
    try:
        return estimate_delay(pairs).seconds
    except InputError as error:
        text = str(error).removesuffix("; give it")
        raise InputError(f"{experiment.name}: {text}; check the columns' units, or take another log") from None


def _check_likeness(experiment: Experiment, run: Recording, delay: float, name: str) -> None:
    """Check that what was measured is like what is simulated with the first values.

    Raises:
        InputError: it is much larger or smaller, or hardly correlated.
    """
    for each in experiment.channels:
        simulated, _ = each.simulated(run, delay)
        if experiment.is_table and each.part is not None:
            continue
        # single outliers don't count
        ends = np.quantile(each.values, [0.02, 0.98])
        values = np.clip(each.values, *(ends + 0.5 * np.ptp(ends) * np.array([-1.0, 1.0])))
        # peaks of a response may be much higher, and elsewhere
        spreads = [
            float(np.std(part) if each.part is None else np.quantile(np.abs(part), 0.9)) for part in (values, simulated)
        ]
        if min(spreads) <= 1e-12 * max(*spreads, 1e-300):
            continue
        ratio = spreads[0] / spreads[1]
        correlation = float(np.corrcoef(values, simulated)[0, 1])
        if not 1.0 / UNLIKE < ratio < UNLIKE and abs(correlation) > HARDLY:
            raise InputError(
                f"{experiment.name}: {each.name} is {ratio:.3g} times as large as simulated: is its unit {each.unit or '1'}? Map it with its "
                f'unit, --map "{each.name.partition("/")[0]}={each.name.partition("/")[0]}*{"1e-3" if ratio > 1.0 else "1e3"}" for example'
            )
        if correlation < HARDLY and experiment.scene is not None and each.part is None:
            at_once = float(np.corrcoef(values, each.simulated(run, 0.0)[0])[0, 1])
            sign = ", and the sign" if min(correlation, at_once) < -HARDLY else ""
            raise InputError(
                f"{experiment.name}: {each.name} has a correlation of {correlation:.2g} with that of {name}: is it a log of this robot and this "
                f"motion? Check columns, units and first values{sign}"
            )


def _candidates(scene: Scene, torques: Sequence[RealArray]) -> Iterable[tuple[str, dict[str, Any]]]:
    """Effects that a scene may lack, in words, and the changes that add them."""
    effects = scene.effects
    for family in ("proximal_bending", "distal_bending", "distal_axial", "proximal_axial"):
        count = getattr(effects, family)
        words = family.replace("_", " ")
        yield (f"{words} (one mode)" if not count else f"one more mode of {words}"), {f"effects.{family}": count + 1}
    size = max((float(np.abs(each).max()) for each in torques), default=10.0)
    others: Mapping[str, tuple[str, Any]] = {
        "joint_friction.viscous": ("viscous friction of the motors", 0.01 * size),
        "joint_friction.coulomb": ("dry friction of the motors", 0.02 * size),
        "motor_inertia": ("inertia of the motors", 0.01),
        "foreshortening": ("foreshortening of bent links", True),
        "transmission": ("elastic transmissions", {"stiffness": 1e5}),
    }
    for key, (words, value) in others.items():
        if not attrgetter(key)(effects):
            yield words, {f"effects.{key}": value}
