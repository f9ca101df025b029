"""`flexfmu plan`: the best motion within limits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexfmu.cosim.cli.console import FAILURE, load_changed, print_rich, print_text, progress, show_note, usual_folder
from flexfmu.cosim.cli.options import ProcessesOption
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.reports.text import to_json

if TYPE_CHECKING:
    from rich.table import Table

    from flexfmu.cosim.design.plans.assessment import Assessment
    from flexfmu.cosim.design.plans.planner import PlanResult
    from flexfmu.model.scene.schema import Scene


def plan(
    scene: str,
    output: Path | None = None,
    out: Path | None = None,
    minimise: str | None = None,
    duration: float | None = None,
    residual: float | None = None,
    payload_band: str | None = None,
    stiffness_band: float | None = None,
    damping_band: float | None = None,
    limit: list[str] | None = None,
    margin: float | None = None,
    corridor: float | None = None,
    method: list[str] | None = None,
    candidate: list[Path] | None = None,
    budget: Annotated[float | None, typer.Option(min=0.0)] = None,
    seed: int | None = None,
    processes: ProcessesOption = None,
    robust: bool = True,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Plan the fastest motion that leaves no vibration, within limits that hold over a band of payloads.

    Writes planned.toml, which every command takes, the Pareto front as front.csv, and plan.html, which
    compares the planned with the given motion. After Ctrl-C the best motion so far is written.

    Args:
        output (-o, --output FILE.toml): Also write the planned scene here. Default: only into --out.
        out (DIR): Folder of the results. Default: results/<name of the scene>-plan.
        minimise (WHAT): time, torque, rms_torque, energy or residual; all but time need --duration. Default: the scene's, or
            time.
        duration (SECONDS): Total time, for all but time. Default: the scene's.
        residual (METRES): Largest residual vibration. Default: the scene's, or 1e-6.
        payload_band (BAND): Payloads for which the limits hold: 0.3 for 30 % to both sides, or 4,8 for 4 to 8 kg. Default: the
            scene's, or 0.3.
        stiffness_band (FRACTION): Relative change of Young's modulus to both sides. Default: the scene's, or 0.
        damping_band (FRACTION): Relative change of the damping to both sides. Default: the scene's, or 0.
        limit (NAME=VALUE): A limit in SI units, torque=80, or as a multiple of the given motion's, jerk=2.5x: torque, speed,
            acceleration, jerk, rms_torque, power, reaction, stress, off_path; may be repeated. Default: torque=1x, speed=2.5x,
            acceleration=2.5x, jerk=2.5x.
        margin (METRES): How far the motion may enter the keep-out region. Default: the scene's, or 1e-4.
        corridor (METRES): How far the motion may leave the given path to the outside. Default: the scene's, or 0.01.
        method (NAME): search, flexible or optimal; may be repeated. Default: all.
        candidate (FILE.csv): A motion of your own, of joints or end effector, to compare; may be repeated.
            Default: none.
        budget (SECONDS): Start no further method or candidate after this time. Default: no limit.
        seed (N): Seed of the search. Default: the scene's, or 0.
        robust: Evaluate the chosen motion in richer models too.
    """
    import os

    from flexfmu.cosim.design.plans.assessment import file_candidate
    from flexfmu.cosim.design.plans.planned_files import summary, write_plan, write_scene
    from flexfmu.cosim.design.plans.planner import METHODS, plan_scene

    if output is not None and output.suffix != ".toml":
        raise InputError(f"a scene file ends in .toml, got {output}: write {output}.toml")
    robot = load_changed(scene, settings)
    wishes: dict[str, Any] = {
        "minimise": minimise, "duration": duration, "residual": residual, "payload_band": _band(payload_band),
        "stiffness_band": stiffness_band, "damping_band": damping_band, "margin": margin, "corridor": corridor, "seed": seed,
    }  # fmt: skip
    robot = _with_wishes(robot, {key: value for key, value in wishes.items() if value is not None}, limit or [])
    folder = out or usual_folder(robot.name, settings, "-plan")
    OutputFolder(folder).prepare()
    with progress() as show:
        result = plan_scene(
            robot,
            methods=method or METHODS,
            candidates=[file_candidate(robot, path) for path in candidate or ()],
            processes=processes or os.cpu_count() or 1,
            budget=budget,
            robust=robust,
            show=show,
        )
        show("writing the results", None)
        files = write_plan(result, folder) + (write_scene(result, output) if output is not None else [])
    for message in result.failures:
        show_note(message)
    if result.interrupted:
        cause = "interrupted" if budget is None else f"interrupted, or the budget of {budget:g} s is spent"
        show_note(f"{cause}: this is the best motion so far")
    if json:
        print_text(to_json({**summary(result), "files": [str(path) for path in files]}))
    else:
        _print(result, [str(path) for path in files])
    return FAILURE if result.missed else 0


def _band(text: str | None) -> float | list[float] | None:
    """A payload band by its option.

    Raises:
        InputError: it is neither a fraction nor two masses.
    """
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 2:
        raise InputError(f"--payload-band takes a fraction, 0.3, or two masses in kg, 4,8; got {text!r}")
    return numbers[0] if len(numbers) == 1 else numbers


def _with_wishes(scene: Scene, wishes: dict[str, Any], limits: list[str]) -> Scene:
    """The scene with the wishes of the options in its section `plan`.

    Raises:
        InputError: a limit has another form.
        SceneError: a wish is invalid.
    """
    changes = {f"plan.{key}": value for key, value in wishes.items()}
    for text in limits:
        name, _, value = text.partition("=")
        number = value.removesuffix("x")
        try:
            changes[f"plan.limits.{name.strip()}"] = {"ratio": float(number)} if value != number else float(number)
        except ValueError:
            raise InputError(f"--limit takes NAME=VALUE, torque=80 in SI units or torque=1.2x; got {text!r}") from None
    return scene.replace(changes) if changes else scene


def _print(result: PlanResult, files: list[str]) -> None:
    """The front, the limits of the chosen motion, and the files."""
    from rich.text import Text

    chosen, given = result.chosen, result.given
    faster = "" if chosen is given else f", {chosen.time / given.time:.3g} of the given time"
    head = f"{result.goals.scene.name}: {chosen.candidate.label}: {chosen.time:.4g} s{faster}"
    tables = [_limits(result), _front(result), *([_robustness(result)] if result.robustness else [])]
    print_rich(Text(head), *tables, Text(result.verdict[0].upper() + result.verdict[1:] + "."))
    print_rich(Text(f"results: {', '.join(files)}"))


def _limits(result: PlanResult) -> Table:
    """How close the chosen motion comes to each limit."""
    from flexfmu.cosim.engine.showing import shown_unit
    from flexfmu.cosim.reports.terminal import titled_table

    table = titled_table("Limits of the chosen motion")
    for name in ("limit", "value", "of", "unit", "used", "where"):
        table.add_column(name, justify="left" if name in ("limit", "unit", "where") else "right")
    for use in result.chosen.uses:
        unit = shown_unit(use.unit)
        table.add_row(use.name, f"{use.value:.3g}", f"{use.limit:.3g}", unit, f"{100 * use.share:.0f} %", use.where)
    return table


SHOWN = 12
"""Motions of the front that the terminal shows."""


def _shown(result: PlanResult) -> list[Assessment]:
    """Motions over the whole front, the given and the chosen one and those to compare with among them."""
    front = list(result.table)
    if len(front) <= SHOWN:
        return front
    chosen = {round(k * (len(front) - 1) / (SHOWN - 3)) for k in range(SHOWN - 2)}
    others = [each.candidate.label for each in result.table if each not in result.front]
    names = {result.chosen.candidate.label, result.given.candidate.label, *others}
    return [each for k, each in enumerate(front) if k in chosen or each.candidate.label in names]


def _front(result: PlanResult) -> Table:
    """The Pareto front."""
    from flexfmu.cosim.design.plans.plan_page import standing
    from flexfmu.cosim.reports.terminal import titled_table

    front, shown = result.table, _shown(result)
    table = titled_table(
        "Pareto front" if len(shown) == len(front) else f"Pareto front: {len(shown)} of {len(front)}, all in front.csv"
    )
    for name in ("motion", "time s", "residual µm", "torque N·m", "energy J", "off path mm", "limits"):
        table.add_column(name, justify="left" if name in ("motion", "limits") else "right")
    for each in shown:
        figures = (
            f"{each.time:.3f}",
            f"{1e6 * each.residual:.2f}",
            f"{each.torque:.1f}",
            f"{each.energy:.1f}",
            f"{1e3 * each.off_path:.2f}",
        )
        table.add_row(each.candidate.label, *figures, standing(result, each))
    return table


def _robustness(result: PlanResult) -> Table:
    """The chosen motion in other models."""
    from flexfmu.cosim.design.plans.plan_page import robustness_table
    from flexfmu.cosim.reports.terminal import as_terminal_table

    return as_terminal_table(robustness_table(result), texts=("Model", "Worst for", "Limits"))
