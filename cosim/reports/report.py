"""The report of a run: a self-contained HTML file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from flexfmu.cosim.metrics.metric_table import ALL_METRICS, display, display_error
from flexfmu.cosim.reports.page import Plot, render
from flexfmu.cosim.reports.summary import motor_rows, stress_rows, title_of
from flexfmu.cosim.reports.work_precision import ACCURACY
from flexfmu.trajectories.path import BLENDS
from flexfmu.trajectories.profiles import PROFILES

TILES = (
    "peak_torque_1",
    "peak_tip_deflection_1",
    "peak_position_error",
    "rms_acceleration_error",
    "residual_vibration_amplitude",
    "settling_time",
)
"""Metrics shown at the top of the report."""


def render_report(summary: Mapping[str, Any], plots: Iterable[Plot]) -> str:
    """Return the report as HTML.

    Args:
        summary: summary of the run by `flexfmu.cosim.reports.summary.summarise`.
        plots: plots of the run by `flexfmu.cosim.reports.plots.draw_plots`.
    """
    health, metrics, errors, drawn = summary["health"], summary["metrics"], summary["errors"], list(plots)
    return render(
        "report.html.j2",
        title=title_of(summary),
        scene=summary["scene"],
        effects=summary["effects"],
        motion=_motion_sentence(summary["scene"], summary.get("motion")),
        completed=health["outcome"] == "completed",
        health=health,
        coarse=[
            {
                "label": ALL_METRICS[warning["metric"]].label,
                "error": display(warning["metric"], warning["estimated_error"], digits=1),
            }
            for warning in health["warnings"]
            if "accuracy" not in summary  # of other figures, which may be coarser
        ],
        tiles=[
            {"label": ALL_METRICS[name].label, "value": display(name, metrics[name], 5, errors[name])} for name in TILES
        ],
        metrics=[
            {
                "label": ALL_METRICS[name].label,
                "name": name,
                "value": display(name, value, error=errors[name]),
                "error": display_error(name, value, errors[name]),
                "description": ALL_METRICS[name].description,
            }
            for name, value in metrics.items()
        ],
        accuracy=summary.get("accuracy"),
        accuracy_plots=[plot for plot in drawn if plot.key.startswith(ACCURACY)],
        plots=[plot for plot in drawn if not plot.key.startswith(ACCURACY)],
        parameters=_scene_rows(summary["scene"]),
        tables=_tables(summary),
        versions=summary["versions"],
    )


def _tables(summary: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return title → rows of the tables below the plots, without empty tables."""
    health, shaping, references = summary["health"], summary.get("shaping"), summary.get("references")
    tables = {
        "Motors": {name: " / ".join(texts) for name, texts in motor_rows(summary.get("motors", ())).items()},
        "Stress of the links": stress_rows(summary.get("stresses", ())),
        "Shaping": {
            "added time": f"{1e3 * shaping['added_time']:.4g} ms",
            "path deviation": f"{1e3 * shaping['path_deviation']:.4g} mm",
        }
        if shaping
        else {},
        "References for the flexible robot": {
            "knots": f"{1e3 * references['knot_spacing']:.4g} ms apart, {1e3 * references['lead']:g} ms before and after the motion",
            "joint jerk": f"up to {references['largest_joint_jerk']:.4g} rad/s³",
            **({"warning": references["warning"]} if "warning" in references else {}),
        }
        if references
        else {},
        "Learning": {
            f"cycle {number}": f"{_milliradians(each['rms'])} mrad RMS, {_milliradians(each['largest'])} mrad at most"
            for number, each in enumerate(summary.get("learning", {}).get("tracking_errors", ()), start=1)
        },
        "Health": {
            "outcome": health["outcome"],
            "simulated": f"{health['end_time'] or 0.0:g} s of {health['stop_time']:g} s",
            "communication step": f"{health['communication_step']:g} s",
            "tolerance": f"{health['tolerance']:g}",
            "input polynomials": f"degree {health['input_order']}",
            **{name: f"{count:,}" for name, count in health["statistics"].items()},
        },
        "Slaves": {slave["name"]: slave["description"] + _sampling(slave) for slave in summary["slaves"]},
        "Signals": {
            delay["connection"]: delay["description"].removeprefix(f"{delay['connection']}: ")
            for delay in summary["delays"]
        },
        "Timing": {name: f"{seconds:.3f} s" for name, seconds in summary["timing"].items()},
        "Results": {name: f"SHA-256 {digest[:16]}…" for name, digest in summary.get("results", {}).items()},
        "Versions": {name: value or "–" for name, value in summary["versions"].items()},
    }
    return {title: rows for title, rows in tables.items() if rows}


def _motion_sentence(scene: Mapping[str, Any], source: str | None) -> str:
    trajectory = scene["trajectory"]
    after = f"then a dwell of {trajectory['dwell']:g} s; payload {scene['payload']['mass']:g} kg."
    if source is not None:
        return f"{source[0].upper()}{source[1:]} in {trajectory['duration']:g} s{_cycles(trajectory)}, {after}"
    blend, profile = BLENDS[trajectory["blend"]["kind"]].label, PROFILES[trajectory["profile"]["kind"]].label
    return (
        f"Pick-and-place motion of {1e3 * trajectory['height']:g} mm × {1e3 * trajectory['width']:g} mm in "
        f"{trajectory['duration']:g} s with {blend} blends and the {profile} profile{_cycles(trajectory)}, {after}"
    )


def _cycles(trajectory: Mapping[str, Any]) -> str:
    if trajectory.get("way_back", "none") == "none":
        return ""
    times = "once" if trajectory["cycles"] == 1 else f"{trajectory['cycles']} times"
    return f", there and back {times} with pauses of {trajectory['pause']:g} s"


def _scene_rows(section: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return the scene flattened to dotted keys; entries of arrays of tables have an index."""
    rows: dict[str, str] = {}
    for key, value in section.items():
        if isinstance(value, Mapping):
            rows |= _scene_rows(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for index, item in enumerate(value):
                rows |= _scene_rows(item, f"{prefix}{key}[{index}].")
        elif not isinstance(value, list) or value:
            rows[prefix + key] = _scene_value(value)
    return rows


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


def _milliradians(values: Iterable[float]) -> str:
    return " / ".join(f"{1e3 * value:.4g}" for value in values)
