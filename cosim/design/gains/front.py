"""Tunes a scene by texts as users write them: ``pd.kp=1e3:1e5``, ``peak_torque<80``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from flexfmu.cosim.design.gains.goals import parse_condition, parse_goal
from flexfmu.cosim.design.gains.journal import Journal
from flexfmu.cosim.design.gains.robustness import PayloadBand, band_masses
from flexfmu.cosim.design.gains.search import Show
from flexfmu.cosim.design.gains.trial import Interval, Study, check_keys
from flexfmu.cosim.design.gains.tuner import TuneResult, tune_study
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.metrics.metric_table import LOOP_METRICS, MOTOR_METRICS
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.schema import Scene


@one_blas_thread()
def tune_scene(
    scene: Scene,
    over: Mapping[str, Sequence[float] | str] | Iterable[str],
    minimise: str = "rms_tracking_error",
    subject_to: Sequence[str] = (),
    *,
    payload_band: PayloadBand | None = None,
    method: str = "gradient",
    trials: int | None = None,
    seed: int = 0,
    processes: int = 1,
    folder: Path | None = None,
    restart: bool = False,
    show: Show = lambda text, fraction: None,
) -> TuneResult:
    """Tune keys of a scene; arguments and errors as for `flexfmu.tune`.

    Args:
        scene: the scene, its effects chosen.
        over: key → (from, to), or texts ``KEY=FROM:TO``.
        minimise, subject_to, payload_band, method, trials, seed, processes: as for `flexfmu.tune`.
        folder: where trials are kept; None for memory.
        restart: whether the trials of another tuning in the folder are discarded.
        show: is called with what is being done, and the finished fraction.
    """
    intervals = _intervals(over)
    if not intervals:
        raise InputError("tuning needs keys and intervals: --over pd.kp=1e3:1e5")
    check_keys(scene, intervals)
    study = Study(
        scene,
        intervals,
        parse_goal(minimise),
        tuple(parse_condition(each) for each in subject_to),
        payload_band,
    )
    if payload_band is not None:
        band_masses(scene, payload_band)
    _check_figures(study)
    journal = None if folder is None else Journal(folder, study, restart=restart)
    return tune_study(study, method=method, trials=trials, seed=seed, processes=processes, journal=journal, show=show)


def _intervals(over: Mapping[str, Sequence[float] | str] | Iterable[str]) -> tuple[Interval, ...]:
    """Keys with their intervals.

    Raises:
        InputError: one has another form.
    """
    if isinstance(over, Mapping):
        return tuple(_interval(key, ends) for key, ends in over.items())
    found = []
    for text in over:
        key, sign, ends = text.partition("=")
        if not (sign and key.strip()):
            raise InputError(f"--over takes KEY=FROM:TO, pd.kp=1e3:1e5 for example, got {text!r}")
        found.append(_interval(key.strip(), ends))
    return tuple(found)


def _interval(key: str, ends: Sequence[float] | str) -> Interval:
    parts = ends.split(":") if isinstance(ends, str) else list(ends)
    try:
        low, high = (float(each) for each in parts)
    except (TypeError, ValueError):
        raise InputError(f"`{key}` is tuned over an interval FROM:TO of two numbers, got {ends!r}") from None
    return Interval(key, low, high)


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
