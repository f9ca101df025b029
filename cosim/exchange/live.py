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
import struct
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.hermite import hermite_derivatives, hermite_scales
from flexfmu.cosim.engine.master.program_image import FUNCTIONS, ProgramImage, program_image
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.shared_library import library_texts
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import measure_run, settings_for
from flexfmu.cosim.metrics.segments import control_matrices, quadrature_of
from flexfmu.cosim.reports.plots import FEW_FRAMES, FRAMES, LONGEST, draw_plots
from flexfmu.cosim.reports.report import render_report
from flexfmu.cosim.reports.summary import summarise
from flexfmu.fmu_build.block_build import sample_function
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.fmu_build.codegen import c_code, function_facts
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.sources import Sources, c_files
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, RUNTIME_FLAGS, WASM, find_compiler
from flexfmu.fmu_build.trajectory_table import TrajectoryTable, tabulate
from flexfmu.fmu_build.wasm_module import model_facts
from flexfmu.model.beams import Shape, scene_shapes
from flexfmu.model.scene.assembly import bases
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Side
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
)
"""Signals that the page shows or computes metrics from."""

BENDING = tuple(f"link{i}{j}.bending[" for i in (1, 2) for j in (1, 2))
"""Begins the names of the coordinates that bend the robot in motion."""

TOLERANCES = (2e-13, 1e-11, 1e-9, 1e-7)
"""Of the motion between knots, relative to the largest value; the run's own references have all bits at its communication points."""

EXPORTED = (
    "fmi2Instantiate",
    "fmi2SetupExperiment",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
    "fmi2FreeInstance",
    "fmi2GetReal",
    "fmi2SetReal",
    "fmi2SetInteger",
    "fmi2SetBoolean",
    "wasm_callbacks",
    "wasm_message",
    "master_run",
    "metrics_prepare",
    "metrics_peak",
    "metrics_products",
    "metrics_last_above",
    "live_hermite",
    "live_function",
    "malloc",
    "free",
    "_initialize",
)
"""Functions that the page calls."""


@dataclass(frozen=True)
class LiveRun:
    """What a page needs to simulate a run.

    Attributes:
        module: the WebAssembly module; empty if the run can't be simulated in a page.
        facts: data for ``simulation.js``, as JSON has them; arrays are base64.
        reason: why the run stays as recorded; empty if it doesn't.
    """

    module: bytes = b""
    facts: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""

    def packed(self) -> str:
        """Everything as gzip in base64."""
        data = {**self.facts, "module": base64.b64encode(self.module).decode()}
        return base64.b64encode(gzip.compress(json.dumps(data).encode(), 9, mtime=0)).decode()


def live_page(run: Run) -> str:
    """The report of a run that simulates, as HTML.

    Raises:
        BuildError: there is no ziglang, or it fails.
        ResultsError, EquilibriumError: as for `flexfmu.measure_run`.
    """
    summary = summarise(run, measure_run(run))
    return report_page(run, summary, settings_for(run).end_equilibrium if run.completed and run.rests else None)


def report_page(run: Run, summary: Mapping[str, Any], rest: RealArray | None) -> str:
    """The same with a summary, and where the robot rests (2,) [m], None for no dwell."""
    found = live_run(run)
    packed = found.packed() if found.module else ""
    return render_report(summary, draw_plots(run, rest, FEW_FRAMES if packed else FRAMES), packed, found.reason)


def live_run(run: Run) -> LiveRun:
    """Compile a run for a page; one that can't be gives the reason.

    Raises:
        BuildError: there is no ziglang, or it fails.
    """
    section = run.scene.cosimulation
    if not run.completed:
        return LiveRun(reason="the run did not finish")
    if section.step_control is not None:
        return LiveRun(reason="its communication steps are controlled")
    prepared = PreparedScene(
        run.scene,
        motion=run.plan,
        communication_step=run.communication_step,
        tolerance=run.tolerance,
        fmu_path=run.fmu_path,
        input_order=run.input_order,
        record=Selection([name for name in run.recording.columns if name in SIGNALS or name.startswith(BENDING)]),
    )
    kinds = (BlockSlave, TrajectorySlave)
    outside = [
        each for each in prepared.parts.slaves if each is not prepared.parts.plant and not isinstance(each, kinds)
    ]
    if outside:
        named = ", ".join(f"{each.name} ({type(each).__name__})" for each in outside)
        return LiveRun(reason=f"it has no C of {named}")
    again = prepared.run(run.parameters)
    simulator = prepared.simulator
    if not again.completed or not simulator.is_compiled:
        return LiveRun(reason="its loop runs in Python")
    # the last initialisation's memory, then what the program refers to
    try:
        references = prepared.parts.references
        table = _table(prepared, references)
        image = program_image(simulator.schedule, simulator.recorder)
    except InputError as error:
        return LiveRun(reason=str(error))
    slaves = simulator.schedule.slaves
    blocks = [each for i in image.blocks if isinstance(each := slaves[i], BlockSlave)]
    if refused := next((each for each in blocks if each.block.libraries or each.block.c_files), None):
        return LiveRun(reason=f"{refused.name!r} calls C of yours")
    with zipfile.ZipFile(run.fmu_path) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
        texts = {
            name.removeprefix("sources/"): archive.read(name).decode()
            for name in archive.namelist()
            if name.startswith("sources/") and name.endswith((".c", ".h"))
        }
    if not texts or root.find("CoSimulation") is None:
        return LiveRun(reason=f"{run.fmu_path.name} has no C sources")
    try:
        facts = _facts(run, prepared, image, table, root)
    except InputError as error:
        return LiveRun(reason=str(error))
    return LiveRun(_compiled(root.get("guid"), texts, blocks), facts)


def _compiled(guid: str, texts: Mapping[str, str], blocks: Sequence[BlockSlave]) -> bytes:
    """The module: FMU, blocks, master and metrics."""
    generated = {name: text for name, text in texts.items() if name.startswith("model_")}
    runtime = {name: text for name, text in texts.items() if name not in generated}
    joined = c_files(runtime)
    beside = library_texts("master") | library_texts("metrics") | library_texts("live")
    numbers = range(len(blocks))
    declared = "".join(f"void block_{k}(void *);\n" for k in numbers)
    listed = ", ".join(f"(function){name}" for name in (*FUNCTIONS, *(f"block_{k}" for k in numbers)))
    # the comment with the GUID keeps a file by itself
    own = {
        "live_functions.c": f'/* {guid} */\n#include "fmi2Functions.h"\n{declared}typedef void (*function)(void);\n'
        f"static const function functions[] = {{{listed}}};\n"
        "FMI2_Export const void *live_function(int k) {\n  return (const void *)functions[k];\n}\n"
    }
    own |= {f"block_{k}.c": f"/* {guid} */\n{_block_code(k, each)}" for k, each in enumerate(blocks)}
    sources = Sources("live", guid, "", generated | own, runtime | beside, {}, joined=joined)
    compiler, exported = find_compiler(WASM), tuple(f"-Wl,--export={name}" for name in EXPORTED)
    flags = tuple(flag for flag in compiler.platform.link_flags if "--export" not in flag)
    platform = replace(compiler.platform, link_flags=(*flags, *exported))
    return compile_library(
        sources,
        replace(compiler, platform=platform),
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


@dataclass(frozen=True)
class _Table:
    """Communication points of a run with the references' limits: times (N,), flags (N,), right limits (N, 5, v), left ones too."""

    times: RealArray
    marked: NDArray[np.bool_]
    due: tuple[NDArray[np.bool_], ...]
    begins: RealArray
    ends: RealArray
    scales: RealArray


def _table(prepared: PreparedScene, references: TrajectorySlave) -> _Table:
    """All blocks of the grid as one table.

    Raises:
        InputError: the polynomials aren't those that the page forms.
    """
    schedule = prepared.simulator.schedule
    parts: list[tuple[Any, ...]] = []
    scales: list[RealArray] = []
    for block in schedule.grid.blocks():
        references.prepare(block.known)
        # the last point of a block is the first of the next
        kept = slice(1 if parts else 0, block.steps + 1)
        if block.grid.recorded is not None:
            raise InputError("not all instants are recorded")
        parts.append(
            (
                block.grid.times[kept],
                block.grid.marked[kept],
                *(each[kept] for each in block.grid.due),
                references.announced[: block.steps + 1, :ENDS][kept],
                references.ended[: block.steps + 1][kept],
            )
        )
        # powers by blocks as in the run: those of other lengths may be rounded otherwise
        widths = np.diff(block.known)
        scales.append(hermite_scales(2 * ENDS, 2, widths).reshape(2 * ENDS, -1).T[: block.steps])
        begins, ends = references.announced[:-1, :ENDS].swapaxes(0, 1), references.ended[1:].swapaxes(0, 1)
        formed = hermite_derivatives(begins, ends, widths[:, None]).swapaxes(0, 1)
        if not references.ends_exactly or not np.array_equal(formed, references.announced[:-1]):
            raise InputError("its motion repeats or has no limits of order 4")
    times, marked, *due, announced, ended = (np.concatenate(each) for each in zip(*parts, strict=True))
    if not marked[0]:
        raise InputError("it begins in the middle of its motion")
    return _Table(times, marked, tuple(due), np.ascontiguousarray(announced), ended, np.concatenate(scales))


def _facts(run: Run, prepared: PreparedScene, image: ProgramImage, table: _Table, root: Any) -> dict[str, Any]:
    """What the page knows beside the module."""
    parts, schedule, recorder = prepared.parts, prepared.simulator.schedule, prepared.simulator.recorder
    model = model_facts(root)
    task, plan = _knots(run.plan.task), run.plan
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
        "model": {"name": model["name"], "guid": model["guid"], "variables": model["variables"]},
        "image": _bytes(bytes(image.data)),
        **{name: getattr(image, name) for name in ("addresses", "functions", "tables", "due", "advance", "exchange")},
        **{name: getattr(image, name) for name in ("script", "handle", "channels")},
        "rows": rows,
        "starts": starts,
        "blocks": image.parameters,
        "static": INITIAL.items["static"][0],
        "rest": rest,
        "step": run.communication_step,
        "tolerance": run.tolerance,
        "stop": float(table.times[-1]),
        "duration": plan.task.duration,
        "band": run.scene.cosimulation.settling_band,
        "breakpoints": [float(each) for each in parts.references.breakpoints],
        "scales_in_time": plan.repetition is None and plan.design is None and not plan.source and not run.scene.shaper,
        "sliders": _sliders(run, image, model["variables"], starts),
        "robot": _robot(run.robot),
        "clocks": [
            [slave.sample_time, slave.offset]
            for i in schedule.due
            if isinstance(slave := schedule.slaves[i], BlockSlave)
        ],
        "grid": {
            "times": _doubles(table.times),
            "marked": _bytes(table.marked.astype(np.uint8).tobytes()),
            "due": [_bytes(each.astype(np.uint8).tobytes()) for each in table.due],
            "scales": _doubles(table.scales),
            **_limits(table, parts.references.trajectory),
        },
        "task": {"times": _doubles(task.times), "jets": _doubles(task.jets[:, :ENDS])},
        "analysis": {
            str(m): {
                "control": _doubles(control_matrices(m)[0]),
                "highest": _doubles(control_matrices(m)[1]),
                "quadratures": {str(k): [_doubles(each) for each in quadrature_of(m, k)] for k in (0, 2)},
            }
            for m in (3, 5)
        },
    }


def _sliders(
    run: Run, image: ProgramImage, variables: Mapping[str, Any], starts: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Parameters that a page may change: those of the robot but for its kinematics, which the motion is planned for, and of blocks."""
    known, found = scene_values(run.scene), list[dict[str, Any]]()
    for name, value in starts.items():
        fixed = name.startswith("start.") or name.endswith((".length", "base_half_distance"))
        variable = variables[name]
        if fixed or variable["type"] != "Real" or variable["causality"] != "parameter" or not value:
            continue
        # an imperfect robot has another value than the scene
        key = known[name].key if name in known and known[name].value == value else ""
        entry = {"name": name, "label": name, "unit": shown_unit(variable.get("unit", "")), "value": abs(value)}
        entry |= {"sign": 1.0 if value > 0.0 else -1.0, "targets": [name], "key": key}
        if name.endswith((".x", ".y")):
            parts = [f"{starts.get(f'{name[:-1]}{axis}', 0.0):g}" for axis in "xy"]
            parts["xy".index(name[-1])] = "*"
            entry["vector"] = f"[{','.join(parts)}]"
        found.append(entry)
    # a parameter that all joints have is one slider
    groups: dict[str, list[str]] = {}
    for name in image.parameters:
        owner, _, rest = name.partition(".")
        groups.setdefault(f"{owner}.{re.sub(r'^joint[12][.]', '', rest)}", []).append(name)
    values = {name: struct.unpack_from("<d", image.data, place)[0] for name, place in image.parameters.items()}
    sections = {each.name or each.kind: each for each in run.scene.controller if hasattr(each, "kind")}
    for name, targets in groups.items():
        owner, _, rest = name.partition(".")
        if rest.endswith("initial") or len({values[each] for each in targets}) > 1 or not values[targets[0]]:
            continue
        gain = rest.removesuffix("_gain")
        key = f"controller.{owner}.{gain}" if hasattr(sections.get(owner), gain) else ""
        value = values[targets[0]]
        found.append(
            {
                "name": name,
                "label": name.replace("_", " "),
                "unit": "",
                "value": abs(value),
                "sign": 1.0 if value > 0.0 else -1.0,
            }
            | {"targets": targets, "key": key}
        )
    plan = run.plan
    if plan.repetition is None and plan.design is None and not plan.source and not run.scene.shaper:
        found.append(
            {
                "name": "duration",
                "label": "duration of the motion",
                "unit": "s",
                "value": plan.duration,
                "targets": [],
                "key": "trajectory.duration",
            }
        )
    return found


def _robot(scene: Scene) -> dict[str, Any]:
    """What the animation needs: bases, lengths, and shapes of the links at points along them."""
    shapes: Mapping[Any, Sequence[Shape]] = scene_shapes(scene)
    found = []
    for leg in (1, 2):
        for number, family in enumerate(("proximal", "distal"), start=1):
            known = shapes.get((family, "bending"), ())
            signals = [f"link{leg}{number}.bending[{mode}]" for mode in range(1, len(known) + 1)]
            xi = np.linspace(0.0, 1.0, 2 * len(known) + 3 if known else 2)
            matrix = np.array([shape.value(xi) for shape in known]).T.tolist() if known else [[], []]
            found.append({"signals": signals, "matrix": matrix})
    mechanism = scene.mechanism
    return {
        "bases": [list(each) for each in bases(mechanism)],
        "length": mechanism.proximal.length,
        "shapes": found,
        "longest": LONGEST,
    }


def _knots(trajectory: Trajectory) -> TrajectoryTable:
    """Knots of a motion, as accurate as can be.

    Raises:
        InputError: no knots reproduce it.
    """
    for tolerance in TOLERANCES:
        try:
            return tabulate(trajectory, tolerance)
        except ModelError:
            continue
    raise InputError("its motion isn't smooth enough for a table")


def _limits(table: _Table, trajectory: Trajectory) -> dict[str, Any]:
    """Knots of the joints' motion, and what its limits at the communication points differ by from what the page evaluates between them.

    Positions to order 6 (N, 7, axes) are all that there is, since velocities and accelerations share them. Differences are those of the
    bits as integers, which are small: they pack to a third of the numbers.
    """
    knots = _knots(trajectory)
    axes = knots.jets.shape[2]

    def limits(jets: RealArray) -> RealArray:
        return np.concatenate([jets[:, k : k + ENDS] for k in range(3)], axis=2)

    def jets(limits: RealArray, *, checked: bool = True) -> RealArray:
        kinds = [limits[:, :, k * axes : (k + 1) * axes] for k in range(3)]
        found = np.concatenate([kinds[0], kinds[1][:, -1:], kinds[2][:, -1:]], axis=1)
        if checked and any(not np.array_equal(found[:, k : k + ENDS], each) for k, each in enumerate(kinds)):
            raise InputError("its references aren't derivatives of one another")
        return found

    def difference(exact: RealArray, times: RealArray, side: Side) -> str:
        found = jets(_evaluated(knots.times, limits(knots.jets), times, side), checked=False)
        return _doubles((exact.view(np.int64) - found.view(np.int64)).view(np.float64))

    jumps = np.flatnonzero((table.begins != table.ends).any(axis=(1, 2)))
    return {
        "knots": _doubles(knots.times),
        "knot_jets": _doubles(knots.jets),
        "knot_scales": _doubles(hermite_scales(2 * ENDS, 2, np.diff(knots.times)).reshape(2 * ENDS, -1).T),
        "jets": difference(jets(table.begins), table.times, "right"),
        "jumps": jumps.tolist(),
        "before": difference(jets(table.ends[jumps]), table.times[jumps], "left"),
    }


def _evaluated(knots: RealArray, limits: RealArray, times: RealArray, side: Side) -> RealArray:
    """Limits (N, 5, v) at some times by polynomials between knots (K,), in the operations of ``Simulation.evaluate`` in simulation.js."""
    steps, variables = len(knots) - 1, limits.shape[2]
    polynomials = np.zeros((steps + 1, 2 * ENDS, variables))
    with np.errstate(all="ignore"):  # of knots that a breakpoint has twice
        formed = hermite_derivatives(
            limits[:-1].swapaxes(0, 1), limits[1:].swapaxes(0, 1), np.diff(knots)[:, np.newaxis]
        )
    polynomials[:-1] = formed.swapaxes(0, 1)
    polynomials[-1, :ENDS] = limits[-1]
    low = np.maximum(np.searchsorted(knots, times, side="right" if side == "right" else "left") - 1, 0)
    h = np.where(low == steps, 0.0, times - knots[low])[:, np.newaxis]
    found = np.empty((times.size, ENDS, variables))
    for order in range(ENDS):
        total = np.zeros((times.size, variables))
        for k in range(2 * ENDS - 1, order - 1, -1):
            total = total * (h / (k - order + 1)) + polynomials[low, k]
        found[:, order] = np.where((low == steps)[:, np.newaxis] & (order > 0), 0.0, total)
    return found


def _bytes(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _doubles(values: Any) -> str:
    """Doubles with equal bytes together, which packs better."""
    flat = np.ascontiguousarray(values, dtype="<f8").reshape(-1)
    return _bytes(flat.view(np.uint8).reshape(-1, 8).T.tobytes())
