"""The report of a run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isclose
from typing import Any, Literal

import numpy as np

from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, definition, display, display_error, larger, without_noise
from flexfmu.cosim.reports.page import FIRST_METRICS, Figure, Page, Plot, Table
from flexfmu.cosim.reports.plots import robot_motion, scene_plot
from flexfmu.cosim.reports.summary import (
    describe_effects,
    instability,
    motor_table,
    stress_table,
    system_summary,
    title_of,
)
from flexfmu.cosim.reports.work_precision import ACCURACY
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.path import BLENDS
from flexfmu.trajectories.profiles import PROFILES

SAME = 1e-6
"""Relative difference below which two torques are the same."""

OFFSET = 0.6
"""The residual vibration is called an offset if its root mean square is more than this share of it, and no peak of its spectrum reaches
the rest. A harmonic has 0.71 of its amplitude as root mean square, but all of it as a peak."""


def report_page(summary: Mapping[str, Any], plots: Iterable[Plot]) -> Page:
    """Return the report.

    Args:
        summary: summary of the run by `flexfmu.cosim.reports.summary.summarise`.
        plots: plots of the run by `flexfmu.cosim.reports.plots.draw_plots`.
    """
    drawn = list(plots)
    completed, accuracy = summary["health"]["outcome"] == "completed", summary.get("accuracy", {}).get("text", ())
    others = [plot for plot in drawn if not plot.key.startswith((ACCURACY, "scene"))]
    return Page(
        title_of(summary),
        [*_verdict(summary, drawn)],
        others,
        tiles=[_tile(name, summary) for name in FIRST_METRICS] if completed else (),
        lead=_motion_sentence(summary["scene"], summary.get("motion")),
        notices=[*_notices(summary)],
        first=[plot for plot in drawn if plot.key == "scene"],
        answers=(accuracy, [plot for plot in drawn if plot.key.startswith(ACCURACY)]),
        folded=list(_tables(summary)),
    )


def of_scene(scene: Scene, run: Run | None = None, place: int = 0) -> dict[str, Any]:
    """What all pages about a scene have: the robot in motion, rigid or as in a run, and effects, scene file and slaves folded away.

    Args:
        scene: the scene.
        run: its run; None for none.
        place: of the run among those of the page.
    """
    try:
        planned = plan(scene) if run is None else run.plan
    except TrajectoryError:  # of a sweep whose cases alone are feasible
        return {}
    robot = None if run is None else robot_motion(planned, run.recording, run.robot) | {"run": place}
    data = scene.model_dump(mode="json", exclude_none=True)
    system = [] if run is None else _system_tables(system_summary(run))
    folded = [_facts("Effects", describe_effects(scene)), _facts("Scene file", dict(_scene_rows(data))), *system]
    return {"first": [scene_plot(planned, robot)], "folded": [table for table in folded if table.rows]}


def _facts(title: str, rows: Mapping[str, str], *, is_open: bool = False) -> Table:
    """A table of names and texts."""
    return Table(title, (), [*rows.items()], texts=1, is_open=is_open)


def _system_tables(summary: Mapping[str, Any]) -> list[Table]:
    """Slaves with the instants at which they sample, and signals with their delays."""
    slaves = {each["name"]: each["description"] + _sampling(each) for each in summary["slaves"]}
    delays = {each["connection"]: each["description"].partition(": ")[2] for each in summary["delays"]}
    return [_facts("Slaves", slaves), _facts("Signals", delays)]


def _notices(summary: Mapping[str, Any]) -> Iterable[tuple[Literal["failed", "warned"], str, str]]:
    health = summary["health"]
    if health["outcome"] != "completed":
        yield "failed", "The simulation did not finish.", health["message"]
    elif reason := instability(health):
        yield "failed", "The loop is unstable.", f"{reason[:1].upper()}{reason[1:]}."
    coarse = [
        f"{ALL_METRICS[each['metric']].label} {display(each['metric'], each['estimated_error'], digits=1)}"
        for each in health["warnings"]
        if "accuracy" not in summary  # of other figures, which may be coarser
    ]
    if coarse:
        yield (
            "warned",
            f"The communication step of {health['communication_step']:g} s is too coarse for some metrics.",
            f"It leaves these uncertain by about: {'; '.join(coarse)}. A smaller `cosimulation.step` resolves them.",
        )
    if health["large_deflections"]:
        sentences = " ".join(f"{each[:1].upper()}{each[1:]}." for each in health["large_deflections"])
        yield "warned", "Links deflect more than linear beam theory allows.", sentences


def _tile(name: str, summary: Mapping[str, Any]) -> tuple[str, Sequence[str]]:
    """One of the six figures, with its limit where the scene has one: the settling band, and the peak torque of equal motors."""
    metrics, torques = summary["metrics"], set[float | None]()
    for motor in summary.get("motors", ()):
        # behind a gear or with a rotor the shaft has another torque than the joint
        (peak,) = (each for each in motor["margins"] if each["name"] == "peak torque")
        is_same = isclose(peak["value"], metrics[f"peak_torque_{motor['joint']}"], rel_tol=SAME)
        torques.add(peak["limit"] if is_same else None)
    limits = {
        "residual_vibration_amplitude": summary["scene"]["cosimulation"]["settling_band"],
        "peak_torque": torques.pop() if len(torques) == 1 else None,
    }
    limit, part = limits.get(name), larger(name, metrics)
    value = Figure.of(name, metrics[part], digits=4, error=summary["errors"][part], limit=limit)
    return definition(name).label + ("" if limit is None else f", limit {display(name, limit, 4)}"), [value]


def _verdict(summary: Mapping[str, Any], plots: Iterable[Plot]) -> Iterator[str]:
    """One sentence in parts: whether it is stable, how the run ended, its worst figure against a limit, what rings, and what bends."""
    health, metrics, band = summary["health"], summary["metrics"], summary["scene"]["cosimulation"]["settling_band"]
    completed, stable = health["outcome"] == "completed", not instability(health)
    recorded = "" if stable and completed else "Failed. " if stable else "Unstable. "
    # the loop at rest is known of the recorded run alone
    yield Figure.said(recorded, "state", is_over=bool(recorded), stays=completed and not health["unstable_loop"])
    if not completed:
        yield f"The results end at {health['end_time'] or 0.0:g} s."
        return

    def figure(name: str, usual: str, *, none: str = "", least: str = "", **more: Any) -> Figure:
        return Figure.of(name, metrics[larger(name, metrics)], digits=3, phrases=(none, least or usual, usual), **more)

    residual = without_noise("residual_vibration_amplitude", metrics["residual_vibration_amplitude"])
    if residual is not None:
        settled = "settles {} after the motion", "has settled at the end of the motion"
        yield "The robot "
        yield figure("settling_time", settled[0], none="does not settle", least=settled[1])
        yield ", with a residual vibration of "
        yield figure("residual_vibration_amplitude", "{}, ")
        relative = {"least": "within the settling band", "limit": band, "is_relative": True}
        yield figure("residual_vibration_amplitude", "{} times the settling band", **relative)
        panel = next((plot.panels[0] for plot in plots if plot.key == "spectrum"), None)
        rms = metrics["residual_vibration_rms"]
        swings = 1e-6 * max((np.max(each.y, initial=0.0) for each in panel.curves), default=0.0) if panel else residual
        ringing = ""
        if rms is not None and rms > OFFSET * residual and swings < (1.0 - OFFSET) * residual:
            ringing = ", mostly an offset that stays"
        elif panel is not None and panel.markers and residual > 0.0:
            peak = panel.markers[0]
            near = min(panel.marks, key=lambda mark: abs(mark[0] - peak.x), default=None)
            mode = f", natural frequency {near[1]}" if near is not None and abs(near[0] - peak.x) < 0.1 * peak.x else ""
            ringing = f", mostly at {peak.text}{mode}"
        yield Figure.said(ringing, "ringing", offset=OFFSET)
        yield "; it"
    else:
        yield "The robot"
    off, none = " is up to {} off its planned motion", " has no position error"
    yield figure("peak_position_error", off, none=none, least=none)
    if metrics[larger("peak_tip_deflection", metrics)]:
        yield figure("peak_tip_deflection", ", while its links bend by up to {}")
    uses = [
        (each["use"], each["name"], motor["joint"]) for motor in summary.get("motors", ()) for each in motor["margins"]
    ]
    if uses:
        use, name, joint = max(uses)
        yield Figure.said(f"; motor {joint} needs {100.0 * use:.3g} % of its {name}", "motor", is_over=use > 1.0)
    yield "."


def _tables(summary: Mapping[str, Any]) -> Iterable[Table]:
    """Yield the tables below the plots, without empty tables."""
    errors = summary["errors"]
    rows = [
        [ALL_METRICS[name].label, name, Figure.of(name, value, error=errors[name]), Figure.said(display_error(name, value, errors[name]), name, isError=True), ALL_METRICS[name].description]
        for name, value in summary["metrics"].items()
    ]  # fmt: skip
    note = f"Metrics are properties of the continuous solution; {summary['health']['errors_from']}."
    yield Table("Metrics", ["Metric", "Name", "Value", "±", "Meaning"], rows, note, 1, is_open=True)
    health, shaping, references = summary["health"], summary.get("shaping"), summary.get("references")
    tables = [
        _facts("Effects", summary["effects"]),
        _facts("Scene file", dict(_scene_rows(summary["scene"]))),
        motor_table(summary.get("motors", ())),
        stress_table(summary.get("stresses", ())),
    ]
    if shaping:
        times = {
            "added time": f"{1e3 * shaping['added_time']:.4g} ms",
            "path deviation": f"{1e3 * shaping['path_deviation']:.4g} mm",
        }
        tables.append(_facts("Shaping", times))
    if references:
        asked = {
            "knots": f"{1e3 * references['knot_spacing']:.4g} ms apart, {1e3 * references['lead']:g} ms before and after the motion",
            "joint jerk": f"up to {references['largest_joint_jerk']:.4g} rad/s³",
            **({"warning": references["warning"]} if "warning" in references else {}),
        }
        tables.append(_facts("References for the flexible robot", asked))
    learned = {
        f"cycle {number}": " mrad RMS, ".join(
            " / ".join(f"{1e3 * value:.4g}" for value in each[kind]) for kind in ("rms", "largest")
        )
        + " mrad at most"
        for number, each in enumerate(summary.get("learning", {}).get("tracking_errors", ()), start=1)
    }
    how = {
        "outcome": health["outcome"],
        "simulated": f"{health['end_time'] or 0.0:g} s of {health['stop_time']:g} s",
        "communication step": f"{health['communication_step']:g} s",
        "tolerance": f"{health['tolerance']:g}",
        "input polynomials": f"degree {health['input_order']}",
        **{name: f"{count:,}" for name, count in health["statistics"].items()},
    }
    tables += [
        _facts("Learning", learned, is_open=True),
        _facts("Health", how),
        *_system_tables(summary),
        _facts("Timing", {name: f"{seconds:.3f} s" for name, seconds in summary["timing"].items()}),
        _facts("Results", {name: f"SHA-256 {digest[:16]}…" for name, digest in summary.get("results", {}).items()}),
        _facts("Versions", {name: value or "–" for name, value in summary["versions"].items()}),
        _facts("Messages of the FMU", {str(number): text for number, text in enumerate(health["messages"], start=1)}),
    ]
    yield from (table for table in tables if table.rows)


def _motion_sentence(scene: Mapping[str, Any], source: str | None) -> str:
    trajectory = scene["trajectory"]
    after = f"then a dwell of {trajectory['dwell']:g} s; payload {scene['payload']['mass']:g} kg."
    if source is not None:
        return f"{source[0].upper()}{source[1:]} in {trajectory['duration']:g} s{_cycles(scene)}, {after}"
    blend, profile = BLENDS[trajectory["blend"]["kind"]].label, PROFILES[trajectory["profile"]["kind"]].label
    return (
        f"Pick-and-place motion of {1e3 * trajectory['height']:g} mm × {1e3 * trajectory['width']:g} mm in "
        f"{trajectory['duration']:g} s with {blend} blends and the {profile} profile{_cycles(scene)}, {after}"
    )


def _cycles(scene: Mapping[str, Any]) -> str:
    trajectory, learning = scene["trajectory"], [each for each in scene["controller"] if each["kind"] == "learning"]
    if not learning and trajectory.get("way_back", "none") == "none":
        return ""
    cycles, pause = (
        (learning[0]["cycles"], trajectory["dwell"]) if learning else (trajectory["cycles"], trajectory["pause"])
    )
    return f", there and back {'once' if cycles == 1 else f'{cycles} times'} with pauses of {pause:g} s"


def _scene_rows(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield dotted keys and values of the scene; entries of arrays of tables have an index."""
    if isinstance(value, Mapping):
        for name, each in value.items():
            yield from _scene_rows(each, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for index, item in enumerate(value):
            yield from _scene_rows(item, f"{key}[{index}]")
    elif value != []:
        yield key, _scene_value(value)


def _scene_value(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"[{_scene_value(item)}]" if isinstance(item, list) else _scene_value(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _sampling(slave: Mapping[str, Any]) -> str:
    """Return the instants at which a slave samples; empty for one that doesn't."""
    if slave["sample_time"] is None:
        return ""
    begin = f" from {slave['offset']:g} s on" if slave["offset"] else ""
    return f", every {slave['sample_time']:g} s{begin}"
