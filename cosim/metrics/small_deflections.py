"""Checks the model's assumption for a run: deflections are small compared with the links' lengths.

The error of the path is estimated from the forces that the next order of the beam theory adds along the recorded
motion: those of foreshortening where the scene leaves it out, and those of exact bending. The linear response to
each is one Newton iteration for the whole motion, as in `flexfmu.cosim.design.effects.estimator`. The motors follow
their recorded motion.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.results import Recording
from flexfmu.fmu_build.cache import content_hash, package_fingerprint, read_cached, store
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.model.scene.choice import DEFAULT_TOLERANCE
from flexfmu.model.selection.response import ElasticMotion, MotionGrid

if TYPE_CHECKING:
    from flexfmu.cosim.experiment.scene_run import Run

LARGEST_ELONGATION = 0.01
"""Largest elongation relative to the link's length; structural metals yield before it."""

USUAL, MOST_FOUND = (2.0, 8.0), (15.0, 50.0)
"""Error of the path divided by the relative deflection (without foreshortening) and by its square (with it): usual
values, and upper bounds of those found, 0.6 to 9.4 and 1 to 18, largest in undamped robots. Where the upper bound is
within the tolerance, nothing is computed; the usual value replaces an estimate where too little was recorded."""

STEP, LEAST, MOST = 5e-4, 2000, 10_000
"""Interval between the instants of the check [s], and limits of their number."""

HOPELESS = 0.5
"""Estimated error above which the estimate itself is not valid."""


_PAIR = struct.Struct("<2d")


def exceeded(run: Run) -> list[str]:
    """Return warnings about a path error from bending above the tolerance, and about overstretched links.

    The tolerance is that of the scene's choice of effects, without one `DEFAULT_TOLERANCE`.
    """
    stretched = [
        f"{name} reaches {100.0 * relative:.3g} % of the link's length: no structural metal stretches by more than "
        f"{100.0 * LARGEST_ELONGATION:g} % without yielding; stiffen or relieve the links"
        for name, relative in _relative(run, "elongation")
        if not relative <= LARGEST_ELONGATION
    ]
    return [*_bent(run), *stretched]


def path_errors(run: Run) -> tuple[float, float]:
    """Return the estimated error of the path because of large deflections, and the error with foreshortening to second order.

    Both are relative: the largest distance from the path with exact bending divided by that of the path from the rigid
    robot's.

    Raises:
        KeyError: a coordinate or the motion of the motors wasn't recorded, or no coordinate is a state.
    """
    from flexfmu.model.selection.linearized_motion import LinearizedMotion

    # recorded motion of motors and links on an equidistant grid
    recording, scene = run.recording, run.robot
    count = int(np.clip((recording.time[-1] - recording.time[0]) / STEP, LEAST, MOST))
    time = np.linspace(recording.time[0], recording.time[-1], count)
    measured = "" if "joint1.position" in recording.columns else ".reference"
    kinds = ("position", "velocity", "acceleration")
    joints = _columns(recording, time, [f"joint{leg}{measured}.{kind}" for kind in kinds for leg in (1, 2)])
    rests = np.concatenate([joints[[0, -1], :2], np.zeros((2, 4))], axis=1)
    grid = MotionGrid(time, joints, rests, ((0, time.size),), float(time[-1]))
    # linearised equations along that motion, as in the scene, with foreshortening, and with exact bending
    own = LinearizedMotion(scene, grid)
    if not own.names:
        raise KeyError("all elastic families of the scene deflect statically")
    short, exact = (LinearizedMotion(scene.replace({"effects.foreshortening": each}), grid) for each in (True, "exact"))
    motion = ElasticMotion(
        *(
            _columns(recording, time, [name.format(each) for each in own.names])
            for name in ("{}", "der({})", "der({},2)")
        )
    )

    def respond(load: NDArray[np.float64]) -> ElasticMotion:
        still = scene.cosimulation.initial == "static"
        start = np.linalg.solve(own.linear.stiffness[0], load[0]) if still else np.zeros(load.shape[1])
        return own.linear.response(load, start)

    # responses to the forces of foreshortening (the difference cancels interpolation errors), then of exact bending
    shortened = motion + respond(own.forces(motion) - short.forces(motion))
    bent = shortened + respond(short.forces(shortened) - exact.forces(shortened))
    ours, theirs, true = (
        robot.outputs(each).position for robot, each in ((own, motion), (short, shortened), (exact, bent))
    )
    rigid = _columns(recording, time, [f"end_effector.reference.position.{axis}" for axis in "xy"])
    unit = _largest(ours - rigid)
    return _largest(true - ours) / unit, _largest(true - theirs) / unit


def kept_path_errors(run: Run) -> tuple[float, float]:
    """Return `path_errors`; those of an equal run are taken from the cache, without loading CasADi.

    Raises:
        KeyError: as for `path_errors`.
    """
    # all that the estimate depends on: sources, scene, and what was recorded
    recording = run.recording
    sources = package_fingerprint(), Path(__file__).read_text(encoding="utf-8"), run.robot.model_dump_json()
    values = (part for name, each in recording.columns.items() for part in (name.encode(), each.values.tobytes()))
    key = content_hash((*map(str.encode, sources), recording.time.tobytes(), *values))
    name = f"path-errors/{key}"
    # eight bytes for each number
    if (known := read_cached(name)) is not None:
        error, remaining = _PAIR.unpack(known)
        return float(error), float(remaining)
    errors = path_errors(run)
    with suppress(ArchiveError):
        store(name, _PAIR.pack(*errors))
    return errors


def _bent(run: Run) -> Iterator[str]:
    """Yield a warning about bending where the error of the path exceeds the tolerance."""
    # a bound from the deflection alone suffices for most runs
    deflection, choice = largest_deflection(run), run.scene.effects.choice
    tolerance, short = DEFAULT_TOLERANCE if choice is None else choice.tolerance, bool(run.robot.effects.foreshortening)
    terms = np.array([deflection**2 if short else deflection, deflection**2])
    if run.robot.effects.foreshortening == "exact" or terms[0] * MOST_FOUND[short] <= tolerance:
        return
    try:
        with np.errstate(all="ignore"):
            error, remaining = kept_path_errors(run)
        how = "the path is off by"
    except KeyError:  # an estimate needs coordinates that are states and were recorded
        (error, remaining), how = terms * (USUAL[short], USUAL[True]), "the path may be off by"
    if error <= tolerance:
        return
    remedy = 'set `effects.foreshortening = "exact"`, whose bending is geometrically exact'
    if not remaining < HOPELESS:
        remedy = "stiffen or relieve the links"
    elif not short and remaining <= tolerance:
        remedy = f"set `effects.foreshortening = true`, which leaves {_percent(remaining)}"
    yield (
        f"links bend by up to {float(f'{100.0 * deflection:.2g}'):g} % of their length: {how} {_percent(error)} of the largest elastic "
        f"deviation, more than the tolerance of {100.0 * tolerance:g} %; {remedy}"
    )


def largest_deflection(run: Run) -> float:
    """Return the largest deflection of any link relative to its length."""
    tips = [relative for _, relative in _relative(run, "tip_deflection")]
    # distal links are pinned at both ends; their first bending mode is largest in the middle
    return max([*tips, *(relative for name, relative in _relative(run, "bending[1]") if name[5] == "2")], default=0.0)


def _relative(run: Run, signal: str) -> Iterator[tuple[str, float]]:
    """Yield the names of a signal of all links, with the largest magnitude relative to the link's length."""
    mechanism = run.robot.mechanism
    for name, column in run.recording.columns.items():
        link, _, kind = name.partition(".")
        if kind == signal and column.values.size:
            length = (mechanism.proximal if link.endswith("1") else mechanism.distal).length
            yield name, float(np.abs(column.values).max()) / length


def _columns(recording: Recording, time: NDArray[np.float64], names: Sequence[str]) -> NDArray[np.float64]:
    """Interpolate signals linearly at instants (N,) and return them as columns (N, names).

    Raises:
        KeyError: a signal wasn't recorded.
    """
    return np.stack([np.interp(time, recording.time, recording[name].values) for name in names], axis=1)


def _largest(vectors: NDArray[np.float64]) -> float:
    """Return the largest norm of vectors (N, 2)."""
    return float(np.linalg.norm(vectors, axis=1).max())


def _percent(error: float) -> str:
    """Format an error in percent with two digits; above `HOPELESS` only that bound."""
    return f"about {100.0 * error:.2g} %" if error < HOPELESS else f"more than {100.0 * HOPELESS:g} %"
