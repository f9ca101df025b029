"""A run as one WebAssembly module with its data, for a page that simulates: robot, blocks and planned motion under the master's loop in C.

The module has the C of the robot's FMU, the equations of controllers, shapers and imperfections that are blocks, `master.c` and the
metrics' C; `flexfmu.cosim.engine.master.program_image` has the run's instructions. With the parameters of the run it gives the bits of the
run. A slave in Python or a foreign FMU stays as recorded; `LiveRun.reason` names it then.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from math import frexp, isfinite, nan, sqrt
from typing import Any

import numpy as np

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.design.margins.loop_warnings import loop_sentences
from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu, parsed
from flexfmu.cosim.engine.hermite import hermite_derivatives, hermite_scales
from flexfmu.cosim.engine.master.program_image import FUNCTIONS, ProgramImage, program_image
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.shared_library import library_texts
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.run_checks import (
    AT_REST,
    BEYOND,
    BEYOND_BEFORE_FAILURE,
    GROWTH_AT_REST,
    LASTING,
    ON_THE_MOVE,
)
from flexfmu.cosim.experiment.run_options import SceneOptions
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS
from flexfmu.cosim.metrics.metrics import measure_run, settings_for
from flexfmu.cosim.metrics.segments import control_matrices, quadrature_of
from flexfmu.cosim.metrics.signals import FIRST_BENDING
from flexfmu.cosim.reports.comparison import ComparedRun
from flexfmu.cosim.reports.page import Figure, Live, Page
from flexfmu.cosim.reports.plots import draw_plots
from flexfmu.cosim.reports.report import report_page
from flexfmu.cosim.reports.summary import summarise
from flexfmu.fmu_build.archive import files_in
from flexfmu.fmu_build.block_build import sample_function
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.fmu_build.codegen import c_code, function_facts
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.sources import Sources, c_files
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, RUNTIME_FLAGS, WASM, find_compiler
from flexfmu.fmu_build.trajectory_table import tabulate
from flexfmu.fmu_build.wasm_module import model_facts
from flexfmu.model.scene.errors import EquilibriumError, SceneError, SceneWarning
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.imperfections import DelaySection
from flexfmu.model.scene.keys import full_key
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import Variable
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.trajectory import Trajectory

ENDS = 5
"""Limits and derivatives of the references at each communication point."""

VECTORS = "-msimd128"
"""Registers of two doubles, as the native binary has them for equal legs; a run takes a quarter less time."""

SIGNALS = (
    *(f"joint{i}.{what}" for i in (1, 2) for what in ("torque", "position", "velocity", "acceleration", "twist")),
    *(f"joint{i}.reference.{kind}" for i in (1, 2) for kind in ("position", "velocity", "acceleration")),
    *(f"end_effector.{kind}.{axis}" for kind in ("position", "velocity", "acceleration") for axis in "xy"),
    *(f"link{i}1.{what}" for i in (1, 2) for what in ("tip_deflection", "elongation")),
    f"der({FIRST_BENDING},2)",
)
"""Signals that the page shows or computes metrics from."""

BENDING = tuple(f"link{i}{j}.bending[" for i in (1, 2) for j in (1, 2))
"""Begins the names of the coordinates that bend the robot in motion."""

ARRAYS = {"f": "Float64Array", "i": "BigInt64Array", "u": "Uint8Array"}
"""Kind of numbers of eight bytes, or of bytes → what JavaScript has for them."""

DIFFERENCES = 6
"""Order of the differences by which signals are packed."""

TOLERANCES = (2e-13, 1e-11, 1e-9, 1e-7)
"""Of the motion between knots, relative to the largest value; the run's own references have all bits at its communication points."""

GUID = "{live}"
"""Of the FMU in the module."""

LARGEST = 1_000_000
"""Bytes of a page with all bits of its run; a larger one evaluates the motion between knots."""

LONG = "simulates within rounding of the run, because all of its bits would take more than 1 MB"
"""What such a page does."""

SPREAD = 3.0
"""Largest factor of a slider's value, either way."""

SWEPT_PLOTS = ("scene", "torques", "tracking", "deflections", "position", "dwell")
"""Plots of a swept scene, that of the robot first."""


@dataclass(frozen=True)
class LiveRun:
    """What a page needs to simulate a run.

    Attributes:
        facts: module and data for ``simulation.js``, as JSON has them, and arrays of `ARRAYS`. Empty if the run can't be simulated.
        reason: why the run stays as recorded; empty if it doesn't.
    """

    facts: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""


def live_page(run: Run) -> str:
    """The report of a run that simulates, as HTML; with or without an input shaper, where both can be had.

    Raises:
        BuildError: there is no ziglang, or it fails.
        ResultsError, EquilibriumError: as for `flexfmu.measure_run`.
    """
    summary = summarise(run, measure_run(run))
    summary["health"] |= loop_sentences(run)
    return live_report(run, summary, _rest(run)).html


def live_report(run: Run, summary: Mapping[str, Any], rest: RealArray | None) -> Page:
    """The same with a summary, and where the robot rests (2,) [m], None for no dwell."""
    found, others = live_run(run), [*_alternatives(run)]
    page = replace(report_page(summary, draw_plots(run, rest)), live=simulating([("", found), *others]))
    if found.facts and len(page.html.encode()) > LARGEST:
        inexact = LiveRun({**found.facts, "grid": {"knots": found.facts["grid"]["knots"]}})
        live = simulating([("", inexact), *others])
        page = replace(page, live=replace(live, reasons=[LONG, *live.reasons]))
    return page


def _alternatives(run: Run) -> Iterator[tuple[str, LiveRun]]:
    """The run without its input shapers, or with the usual one, where that can be run."""
    name, shapers = ("without shaper", []) if run.scene.shaper else ("ZV shaper", [{"kind": "zv"}])
    if run.plan.source or run.plan.design is not None or run.plan.repetition is not None or not run.completed:
        return
    try:
        scene = run.scene.replace({"shaper": shapers})
        other = PreparedScene(scene, **_options(run)).run(run.parameters)
    except (CosimError, SceneError, EquilibriumError, TrajectoryError):  # a rigid robot, a path out of reach
        return
    found = live_run(other, is_exact=False)
    if found.facts:
        yield name, found


def simulating(
    runs: Sequence[tuple[str, LiveRun]],
    places: Sequence[int] = (),
    swept: Mapping[str, Sequence[Any]] | None = None,
    fixed: Mapping[str, str] | None = None,
) -> Live:
    """What a page simulates.

    Args:
        runs: option of the page's user and run: those of the same place are alternatives to each other.
        places: of the runs among those that the page shows; empty for one run and its alternatives.
        swept: key → the same as the sweep has it, smallest and largest value of its slider; None for the usual sliders.
        fixed: swept key that has no slider → its value here.
    """
    known, content = dict[bytes, int](), bytearray()

    def pooled(data: Any) -> Any:
        if isinstance(data, np.ndarray):
            binary = data.tobytes()
            if binary not in known:
                known[binary] = len(content)
                content.extend(binary)
            return {"array": ARRAYS[data.dtype.kind], "at": known[binary], "size": len(binary)}
        if isinstance(data, Mapping):
            return {key: pooled(each) for key, each in data.items()}
        return [*map(pooled, data)] if isinstance(data, list | tuple) else data

    there = [
        pooled({**run.facts, "place": place, "option": option})
        for (option, run), place in zip(runs, places or [0] * len(runs), strict=True)
        if run.facts
    ]
    reasons = [f"can't simulate {option or 'the run'}: {run.reason}" for option, run in runs if run.reason]
    if not there:
        return Live(reasons=reasons)
    reasons += [f"can't simulate other values of {', '.join(fixed)}, which stay as in the scene"] if fixed else []
    head = json.dumps({"runs": there, "swept": swept or {}, "fixed": fixed or {}}).encode()
    return Live(base64.b64encode(gzip.compress(head + b"\n" + bytes(content), 9, mtime=0)).decode(), reasons)


def side_by_side(page: Page, runs: Sequence[ComparedRun]) -> Page:
    """The page of several runs, of which it simulates those that it has room for; results without a run and what failed stay as recorded."""
    found, live = list[tuple[str, LiveRun]](), Live()
    room = LARGEST - len(replace(page, live=Live("-")).html.encode())
    for each in runs:
        reason = f"it failed: {each.failure}" if each.failure else "only its results are known"
        one = LiveRun(reason=reason) if each.run is None else live_run(each.run, is_exact=False)
        # reasons need room, too
        for option in (one, LiveRun(reason="the page would be larger than 1 MB")):
            live = simulating([*found, (each.name, option)], range(len(found) + 1))
            if len(live.packed) + sum(map(len, live.reasons)) < room:
                break
        found.append((each.name, option))
    return replace(page, live=live)


def swept_page(
    page: Page,
    scene: Scene,
    swept: Mapping[str, tuple[float, float] | None],
    own: Mapping[str, str],
    names: Sequence[str],
) -> Page:
    """The page of a sweep with its scene, which runs at a point that is picked, or where the sliders of the swept keys are.

    Args:
        page: of the sweep.
        scene: what was swept.
        swept: key of the scene, as it was written → smallest and largest value; None for a key with other values than numbers.
        own: key → the scene's value, as the page has those of points.
        names: metrics of the page's tiles, which have extremes and get the value here.
    """
    run = run_scene(scene)
    found = live_run(run, is_exact=False)
    if not found.facts:
        return replace(page, live=simulating([("", found)]))
    # of a robot that is designed anew a key has no slider: that would be another case of the sweep
    data, sliders = scene.model_dump(mode="json", exclude_none=True), found.facts["sliders"]
    there = {each["key"] for each in sliders if not each.get("frozen")}
    full = {key: full_key(data, key) for key in swept}
    spans = {key: span for key, span in swept.items() if span is not None and full[key] in there}
    known = {full[key]: [key, *span] for key, span in spans.items() if span[0] < span[1]}
    fixed = {full[key]: key for key in swept if key not in spans}
    facts = {**found.facts, "sliders": [each for each in sliders if each["key"] not in fixed]}
    live = simulating([("", LiveRun(facts))], swept=known, fixed={key: own[key] for key in fixed.values()})
    first, *others = (each for each in draw_plots(run, _rest(run)) if each.key in SWEPT_PLOTS)
    metrics, tiles = measure_run(run), list[tuple[str, Sequence[str]]]()
    for name, (label, ends) in zip(names, page.tiles, strict=False):
        value = Figure.of(name, metrics[name].value, digits=4, error=metrics[name].error)
        tiles.append((f"{label.partition(', from')[0]}; in the sweep {' to '.join(ends)}", [value]))
    return replace(page, live=live, first=[first], plots=[*page.plots, *others], tiles=tiles)


def _rest(run: Run) -> RealArray | None:
    return settings_for(run).end_equilibrium if run.completed and run.rests else None


def _options(run: Run) -> SceneOptions:
    """Those of a run, with the signals of a page."""
    return {
        "communication_step": run.communication_step,
        "tolerance": run.tolerance,
        "fmu_path": run.fmu_path,
        "input_order": run.input_order,
        "record": Selection([name for name in run.recording.columns if name in SIGNALS or name.startswith(BENDING)]),
    }


def live_run(run: Run, *, is_exact: bool = True) -> LiveRun:
    """Compile a run for a page; one that can't be gives the reason.

    Args:
        run: the run.
        is_exact: whether the page's run has all bits of this one; otherwise it evaluates the motion between knots, in a third of the data.

    Raises:
        BuildError: there is no ziglang, or it fails.
    """
    try:
        return LiveRun(_simulated(run, is_exact=is_exact))
    except InputError as error:
        return LiveRun(reason=str(error))


def _simulated(run: Run, *, is_exact: bool) -> dict[str, Any]:
    """Module and data of a run.

    Raises:
        InputError: it can't be had; the message is the reason.
        BuildError: as for `live_run`.
    """
    if not run.completed:
        raise InputError("the run did not finish")
    if run.plan.repetition is not None:
        raise InputError("its motion repeats")
    if run.scene.cosimulation.step_control is not None:
        raise InputError("its communication steps are controlled")
    motion, options = _own_motion(run), _options(run)
    try:
        prepared = PreparedScene(_tunable(run.scene), motion=motion, **options)
    except CosimError:  # a loop that only a delay of a sample breaks
        prepared = PreparedScene(run.scene, motion=motion, **options)
    kinds = (BlockSlave, TrajectorySlave)
    slaves = [each for each in prepared.parts.slaves if each is not prepared.parts.plant]
    if outside := [f"{each.name} ({type(each).__name__})" for each in slaves if not isinstance(each, kinds)]:
        raise InputError(f"there is no C of {', '.join(outside)}")
    again, simulator = prepared.run(run.parameters), prepared.simulator
    if not again.completed or not simulator.is_compiled:
        raise InputError("its loop runs in Python")
    # the last initialisation's memory, then what the program refers to
    grid = _grid(prepared, is_exact=is_exact)
    image = program_image(simulator.schedule, simulator.recorder)
    blocks = [each for i in image.blocks if isinstance(each := simulator.schedule.slaves[i], BlockSlave)]
    if refused := next((each for each in blocks if each.block.libraries or each.block.c_files), None):
        raise InputError(f"{refused.name!r} calls C of yours")
    files = files_in(run.fmu_path, "sources")
    texts = {name: text.decode() for name, text in files.items() if name.endswith((".c", ".h"))}
    if not texts or open_fmu(run.fmu_path).kind != "CoSimulation":
        raise InputError(f"{run.fmu_path.name} has no C sources")
    return {
        **_facts(run, again, prepared, image),
        "grid": grid,
        "module": np.frombuffer(_compiled(texts, blocks), np.uint8),
    }


def _tunable(scene: Scene) -> Scene:
    """The scene with delays that are parameters, where they aren't and can be; it has the same bits."""
    longest = {
        f"imperfection[{n}].longest": SPREAD * each.time
        for n, each in enumerate(scene.imperfection)
        if isinstance(each, DelaySection) and each.time and each.longest is None and each.interpolation.kind == "linear"
    }
    return scene.replace(longest)


def _own_motion(run: Run) -> MotionPlan | None:
    """The motion, if it is that of an object, which the scene doesn't have."""
    return run.plan if run.plan.source and isinstance(run.scene.trajectory, TrajectorySection) else None


def _compiled(texts: Mapping[str, str], blocks: Sequence[BlockSlave]) -> bytes:
    """The module: FMU, blocks, master and metrics. Name and GUID are left out, so that FMUs of equal equations have the same one."""
    generated = {
        name: re.sub(r'(\.(?:name|guid) = )".*"', rf'\1"{GUID}"', text)
        for name, text in texts.items()
        if name.startswith("model_")
    }
    runtime = {name: text for name, text in texts.items() if name not in generated}
    joined = c_files(runtime)
    beside = library_texts("master") | library_texts("metrics") | library_texts("live")
    numbers = range(len(blocks))
    declared = "".join(f"void block_{k}(void *);\n" for k in numbers)
    listed = ", ".join(f"(function){name}" for name in (*FUNCTIONS, *(f"block_{k}" for k in numbers)))
    # the comment with the GUID keeps a file by itself
    own = {
        "live_functions.c": f'/* {GUID} */\n#include "fmi2Functions.h"\n{declared}typedef void (*function)(void);\n'
        f"static const function functions[] = {{{listed}}};\n"
        "FMI2_Export const void *live_function(int k) {\n  return (const void *)functions[k];\n}\n"
    }
    own |= {f"block_{k}.c": f"/* {GUID} */\n{_block_code(k, each)}" for k, each in enumerate(blocks)}
    sources = Sources("live", GUID, "", generated | own, runtime | beside, {}, joined=joined)
    return compile_library(
        sources,
        find_compiler(WASM),
        runtime_flags=(*RUNTIME_FLAGS, VECTORS),
        generated_flags=(*GENERATED_FLAGS, VECTORS),
    )


def _block_code(number: int, slave: BlockSlave) -> str:
    """C of a block's equations, and a function that calls them with the addresses of x, u, p, y and next x."""
    function = sample_function(slave.block)
    facts = function_facts("sample", function)
    return (
        f"{c_code(function).replace(function.name(), f'block_{number}_sample')}\n"
        f"void block_{number}(void *memory) {{\n  double **m = memory;\n"
        f"  static casadi_int iw[{facts.n_iw} + 1];\n  static double w[{facts.n_w} + 1];\n"
        f"  const double *arg[{facts.n_arg}] = {{m[0], m[1], m[2]}};\n  double *res[{facts.n_res}] = {{m[3], m[4]}};\n"
        f"  block_{number}_sample(arg, res, iw, w, 0);\n}}\n"
    )


def _grid(prepared: PreparedScene, *, is_exact: bool) -> dict[str, Any]:
    """Knots of the joints' motion, from which a page forms the references at any communication points; and, if it is to be exact, the
    run's own points with the limits there.

    Raises:
        InputError: the polynomials aren't those that the page forms.
    """
    references = prepared.parts.references
    times, jets = _knots(references.trajectory)
    # positions, velocities and accelerations side by side, each with its derivatives
    found = {"knots": {"times": times, "begins": np.concatenate([jets[:, k : k + ENDS] for k in range(3)], axis=2)}}
    parts: list[tuple[Any, ...]] = []
    for block in prepared.simulator.schedule.grid.blocks():
        references.prepare(block.known)
        # the last point of a block is the first of the next
        kept = slice(1 if parts else 0, block.steps + 1)
        if block.grid.recorded is not None:
            raise InputError("not all instants are recorded")
        announced, ended = references.announced[: block.steps + 1, :ENDS], references.ended[: block.steps + 1]
        # powers by blocks as in the run: those of other lengths may be rounded otherwise
        widths = np.diff(block.known)
        scales = hermite_scales(2 * ENDS, 2, widths).reshape(2 * ENDS, -1).T[: block.steps]
        points = [each[kept] for each in (block.grid.times, block.grid.marked, announced, ended, *block.grid.due)]
        parts.append((scales, *points))
        begins, ends = references.announced[:-1, :ENDS].swapaxes(0, 1), references.ended[1:].swapaxes(0, 1)
        formed = hermite_derivatives(begins, ends, widths[:, None]).swapaxes(0, 1)
        if not references.ends_exactly or not np.array_equal(formed, references.announced[:-1]):
            raise InputError("its motion has no four derivatives")
    scales, times, marked, announced, ended, *due = (np.concatenate(each) for each in zip(*parts, strict=True))
    if not marked[0]:
        raise InputError("it begins in the middle of its motion")
    if not is_exact:
        return found
    jumps = np.flatnonzero((announced != ended).any(axis=(1, 2)))
    return found | {
        "times": times,
        "marked": marked.astype(np.uint8),
        "due": [each.astype(np.uint8) for each in due],
        "scales": scales,
        "begins": _differences(announced),
        "jumps": jumps.tolist(),
        "before": ended[jumps],
    }


def _facts(run: Run, again: Run, prepared: PreparedScene, image: ProgramImage) -> dict[str, Any]:
    """What the page knows beside the module, of a run and the same with tunable delays."""
    parts, schedule, recorder = prepared.parts, prepared.simulator.schedule, prepared.simulator.recorder
    variables = model_facts(parsed(open_fmu(run.fmu_path).folder).getroot())["variables"]
    plan, (times, jets) = run.plan, _knots(run.plan.task)
    # starts as the FMU takes them, and where it rests at the end
    starts = dict(parts.plant.start_numbers)
    end, position = plan.end_pose
    rest = {f"joint{i}.reference.position": float(q) for i, q in enumerate(end, start=1)}
    if run.scene.cosimulation.drive != "motion":
        rest = {f"start.{axis}": float(value) for axis, value in zip("xy", position, strict=True)}
    places = recorder.places
    rows = {
        name: [places[source.name][0], list(places[source.name][1])]
        for name, source in prepared.recording.named.items()
        if source.name in places
    }
    return {
        "name": run.scene.name,
        "model": {"guid": GUID, "variables": variables},
        **_copied(run, prepared),
        "image": np.frombuffer(image.data, np.uint8),
        **{name: getattr(image, name) for name in ("words", "advance", "exchange", "script", "handle", "channels")},
        "rows": rows,
        "starts": starts,
        "blocks": image.parameters,
        "static": INITIAL.items["static"][0],
        "rest": rest,
        "step": run.communication_step,
        "tolerance": run.tolerance,
        "stop": plan.stop_time,
        "duration": plan.task.duration,
        "band": run.scene.cosimulation.settling_band,
        "divergence": _divergence(run),
        "breakpoints": [float(each) for each in parts.references.breakpoints],
        **_sliders(again, prepared, variables, starts, image.parameters),
        "clocks": [
            [slave.sample_time if isfinite(slave.sample_time) else None, slave.offset, slave.instants]
            for i in schedule.due
            if isinstance(slave := schedule.slaves[i], BlockSlave)
        ],
        "motors": _motors(run.scene),
        "metrics": {name: each.how for name, each in ALL_METRICS.items()},
        "task": {"times": times, "begins": jets[:, :ENDS]},
        "analysis": {
            m: {"matrices": control_matrices(m), "quadratures": {k: quadrature_of(m, k) for k in (0, 2)}}
            for m in (3, 5)
        },
    }


def _motors(scene: Scene) -> list[dict[str, Any]]:
    """The motors of both joints; none where the scene has none, or ones with limits that a page doesn't compute."""
    motors = [scene.motor.of_joint(joint) for joint in (0, 1)] if scene.motor else []
    is_known = not any(each.torque_speed_curve or each.thermal_time_constant for each in motors)
    return [asdict(each) for each in motors] if is_known else []


def _sliders(
    run: Run,
    prepared: PreparedScene,
    variables: Mapping[str, Any],
    starts: Mapping[str, float],
    blocks: Mapping[str, int],
) -> dict[str, Any]:
    """Keys of the scene that a page may change: of the robot, but for lengths, which the motion is planned for, of the loop, the duration.

    A key of the loop is one that changes nothing but parameters of blocks, each by a power of the key's value; so is the duration if
    nothing but references depends on it. Where more than the robot itself depends on its parameters, a shaper for example, or the shapes of
    its links do, the page keeps that as it was designed (``frozen``), and a copied scene has the robot's real values beside the assumed ones.
    """
    scene, known, found = run.scene, scene_values(run.scene), list[dict[str, Any]]()
    motion = _own_motion(run)
    laws, own = usual = _loop(scene, {}, motion)

    def add(
        name: str, key: str, value: float, unit: str, targets: Sequence[tuple[str, float, int]], **more: Any
    ) -> None:
        low, high = _span(scene, key, value)
        shown, factor = ("GPa", 1e-9) if unit == "Pa" else (unit, 1.0)
        entry = {"name": name, "label": name, "key": key, "value": value, "low": low, "high": high, "unit": shown}
        found.append(entry | {"factor": factor, "targets": targets} | more)

    # the robot
    kinematic = ("start.x", "start.y", "proximal.length", "distal.length", "base_half_distance")
    robot = {
        name: key
        for name, key in _robot_keys(scene).items()
        if starts.get(name) and name not in kinematic and variables[name]["causality"] == "parameter"
    }
    designed = bool(scene.shaper or run.plan.design or run.parameters or prepared.parts.unfed)
    if not designed and (scene.controller or scene.imperfection):
        designed = _loop(scene, {key: 1.01 * starts[name] for name, key in robot.items()}, motion) != usual
    # shapes of Timoshenko's beams are those of the scene's slenderness
    slender = ("diameter", "poissons_ratio") if scene.effects.beam == "timoshenko" else ()
    for name, key in robot.items():
        value, assumed = starts[name], known[name].value
        label = name if value == assumed else f"{name} (the scene has {assumed:g})"
        unit = shown_unit(variables[name].get("unit", ""))
        add(name, key, value, unit, [(name, value, 1)], label=label, frozen=designed or key.endswith(slender))
    # the loop
    for name, key, value in _numbers(scene.model_dump(mode="json", exclude_none=True)):
        # half the value halves what is proportional to it, to the last bit
        others, changed = _loop(scene, {key: 0.5 * value}, motion)
        powers = _powers(own, changed) if others == laws else {}
        if powers and powers.keys() <= blocks.keys():
            units = {shown_unit(own[target].unit) if power == 1 else "" for target, power in powers.items()}
            targets = [(target, own[target].start or 0.0, power) for target, power in powers.items()]
            taken = any(each["name"] == name for each in found)
            add(key if taken else name, key, value, units.pop() if len(units) == 1 else "", targets)
    # the duration
    key, duration = "trajectory.duration", run.plan.duration
    reasons = {
        "an input shaper acts on the motion": scene.shaper,
        "the motion is that of an object": motion,
        "the motion repeats": run.plan.repetition,
        "its references are those of the flexible robot": run.plan.design,
    }
    fixed = next((reason for reason, holds in reasons.items() if holds), "")
    if not fixed and _loop(scene, {key: 1.1 * duration}) != usual:
        fixed = "the loop is designed for it"
    if not fixed:
        add("duration", key, duration, "s", [], label="duration of the motion")
    return {"sliders": found, "fixed": fixed}


def _robot_keys(scene: Scene) -> dict[str, str]:
    """Name of the FMU parameter → key in the scene, of a component with its index."""
    indices = {".x": "[0]", ".y": "[1]"}
    return {name: each.key + indices.get(name[-2:], "") for name, each in scene_values(scene).items()}


def _loop(
    scene: Scene, changes: dict[str, Any], motion: MotionPlan | None = None
) -> tuple[list[Any] | None, dict[str, Variable]]:
    """The loop that a scene with changes has around its robot: laws of all blocks, None where it can't have the changes, and their
    parameters by ``slave.name``."""
    try:
        scene = scene.replace(changes)
        loop = loop_of(scene, motion and replace(motion, scene=scene))
    except (SceneError, CosimError):
        return None, {}
    slaves = (*loop.controllers, *(inline.slave for inline in loop.inline_blocks), *loop.disturbances)
    blocks = [each for each in slaves if isinstance(each, BlockSlave)]
    laws = [(s.name, s.sample_time, s.offset, s.block.states, sample_function(s.block).serialize()) for s in blocks]
    return laws, {f"{each.name}.{one.name}": one for each in blocks for one in each.block.parameters}


def _numbers(data: Mapping[str, Any]) -> Iterator[tuple[str, str, float]]:
    """Short name, key and value of the numbers in sections of the loop; one of both joints if they are equal."""
    for array in ("controller", "imperfection", "filter", "disturbance"):
        for place, section in enumerate(data.get(array, ())):
            for name, value in section.items():
                key, short = f"{array}[{place}].{name}", f"{section.get('name') or section['kind']}.{name}"
                each = value if isinstance(value, list) else [value]
                if not all(isinstance(one, float) and one for one in each):
                    continue
                if len({*each}) == 1:
                    yield short, key, each[0]
                else:
                    yield from ((f"{short}[{i}]", f"{key}[{i}]", one) for i, one in enumerate(each))


def _powers(own: Mapping[str, Variable], changed: Mapping[str, Variable]) -> dict[str, int]:
    """Parameter of a block → the power of a key's value that it is proportional to, from its change with half the value; empty if any isn't."""
    ratios = {
        name: frexp((own[name].start or nan) / (each.start or nan))
        for name, each in changed.items()
        if name in own and each != own[name]
    }
    is_power = all(fraction == 0.5 and exponent != 1 for fraction, exponent in ratios.values())
    return {name: exponent - 1 for name, (_, exponent) in ratios.items()} if is_power else {}


def _span(scene: Scene, key: str, value: float) -> tuple[float, float]:
    """Smallest and largest value of a slider: a third and three times the value, or half as far as the scene's checks allow.

    Half, by ratio, since two keys that limit each other, as outer and inner diameter do, may both go to their ends.
    """

    def is_valid(factor: float) -> bool:
        try:
            scene.replace({key: factor * value})
        except SceneError:
            return False
        return True

    ends = []
    for end in (1.0 / SPREAD, SPREAD):
        good = bad = end
        if not is_valid(end):
            good = 1.0
            for _ in range(8):
                middle = sqrt(good * bad)
                good, bad = (middle, bad) if is_valid(middle) else (good, middle)
            good = sqrt(good)
        ends.append(good * value)
    return ends[0], ends[1]


def _copied(run: Run, prepared: PreparedScene) -> dict[str, Any]:
    """What is needed to copy the run: its scene, the file or name that this comes from, and the keys with other values than there; no file
    if that can't be said."""
    scene, keys = run.scene, _robot_keys(run.scene)
    own = {name: value for name, value in run.parameters.items() if prepared.parts.changes.get(name) != value}
    if scene.has_objects or _own_motion(run) or own.keys() - keys.keys():
        return {"scene": None, "origin": ""}
    changes: dict[str, Any] = {"cosimulation.step": run.communication_step, "cosimulation.tolerance": run.tolerance}
    if own:
        kept = scene.model_dump(exclude_none=True)["imperfection"]
        real = {keys[name]: value for name, value in own.items()}
        changes["imperfection"] = [*kept, {"kind": "parameter-error", "parameters": real}]
    scene = scene.replace(changes)
    whole = scene.model_dump(mode="json", exclude_none=True)
    short = scene.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    short["effects"].pop("choice", None)
    # beside the file
    before, settings = dict[str, Any](), dict[str, Any]()
    with suppress(SceneError), warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        before = load_scene(scene.origin).model_dump(mode="json", exclude_none=True)
        if "select" in before["effects"]:  # which fills in the tolerance
            del before["cosimulation"]["tolerance"]
    for name, value in whole.items():
        known = before.get(name)
        if isinstance(value, dict) and isinstance(known, dict) and known.keys() <= value.keys():
            others = {key: each for key, each in value.items() if each != known.get(key)}
            settings |= {f"{name}.{key}": short[name].get(key, each) for key, each in others.items()}
        elif value != known:
            settings[name] = short.get(name, value)
    # no --set takes a section away
    origin = scene.origin if before and before.keys() <= whole.keys() else ""
    return {"scene": short, "origin": origin, "settings": [*settings.items()]}


def _divergence(run: Run) -> dict[str, float]:
    """Largest velocity of the motion [rad/s], and from which errors of its joints on a loop is unstable, see `divergence`; empty without a loop."""
    if run.scene.cosimulation.drive != "torque" or not run.scene.controller:
        return {}
    return {
        "speed": run.plan.top_speed,
        "beyond": BEYOND,
        "beforeFailure": BEYOND_BEFORE_FAILURE,
        "atRest": AT_REST,
        "onTheMove": ON_THE_MOVE,
        "growth": GROWTH_AT_REST,
        "lasting": LASTING,
    }


def _knots(trajectory: Trajectory) -> tuple[RealArray, RealArray]:
    """Times (K,) and jets (K, 7, axes) of the knots of a motion, as accurate as can be; it rests at the last.

    Raises:
        InputError: no knots reproduce it.
    """
    for tolerance in TOLERANCES:
        try:
            table = tabulate(trajectory, tolerance)
        except ModelError:
            continue
        rest = np.zeros_like(table.jets[:1])
        rest[:, 0] = table.jets[-1:, 0]
        return np.append(table.times, table.times[-1]), np.concatenate([table.jets, rest])
    raise InputError("its motion isn't smooth enough for a table")


def _differences(signals: RealArray) -> list[Any]:
    """Each of the signals (N, ...) as the differences of its bits, of order 6 over the instants: of what is smooth they are small. Equal
    ones, as velocities are derivatives of positions, lie in a page once."""
    bits = np.ascontiguousarray(signals.reshape(len(signals), -1).T).view(np.int64)
    return [*np.diff(bits, DIFFERENCES, prepend=np.zeros((len(bits), DIFFERENCES), np.int64))]
