"""`flexfmu plan`: the best motion within limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexfmu.cosim.cli.console import (
    FAILURE,
    check_scene_file,
    load_changed,
    prepared_folder,
    print_result,
    progress,
    show_note,
    usual_folder,
)
from flexfmu.cosim.cli.options import ProcessesOption
from flexfmu.cosim.engine.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

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
    restart: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Plan the fastest motion that leaves no vibration, within limits that hold over a band of payloads.

    Writes planned.toml, which every command takes, the Pareto front as front.csv, and plan.html, which
    compares the planned with the given motion. After Ctrl-C the best motion so far is written. All that is found is kept at once:
    whatever ends the command, the same command continues.

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
        restart: Discard what an interrupted plan for another scene or other limits has left in the folder. Default: refuse.
    """
    import os

    from flexfmu.cosim.design.gains.robustness import parse_band
    from flexfmu.cosim.design.plans.assessment import file_candidate
    from flexfmu.cosim.design.plans.planned_files import summary, write_plan, write_scene
    from flexfmu.cosim.design.plans.planner import METHODS, plan_scene
    from flexfmu.cosim.many.journal import WorkJournal, about_scene

    check_scene_file(output)
    robot = load_changed(scene, settings)
    band = None if payload_band is None else parse_band(payload_band)
    wishes: dict[str, Any] = {
        "minimise": minimise, "duration": duration, "residual": residual, "payload_band": band,
        "stiffness_band": stiffness_band, "damping_band": damping_band, "margin": margin, "corridor": corridor, "seed": seed,
    }  # fmt: skip
    robot = _with_wishes(robot, {key: value for key, value in wishes.items() if value is not None}, limit or [])
    folder = out or usual_folder(robot.name, settings, "-plan")
    prepared_folder(folder)
    journal = WorkJournal(folder, "plan", about_scene(robot), restart=restart, note=show_note)
    with progress() as show:
        result = plan_scene(
            robot,
            methods=method or METHODS,
            candidates=[file_candidate(robot, path) for path in candidate or ()],
            processes=processes or os.cpu_count() or 1,
            budget=budget,
            robust=robust,
            show=show,
            journal=journal,
        )
        show("writing the results", None)
        files = write_plan(result, folder) + (write_scene(result, output) if output is not None else [])
    if not result.interrupted:
        journal.remove()
    for message in result.failures:
        show_note(message)
    if result.interrupted:
        cause = "interrupted" if budget is None else f"interrupted, or the budget of {budget:g} s is spent"
        show_note(f"{cause}: this is the best motion so far")
    names = [str(path) for path in files]
    print_result(json, {**summary(result), "files": names}, *_shown(result), f"results: {', '.join(names)}")
    return FAILURE if result.missed else 0


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


SHOWN = 12
"""Motions of the front that the terminal shows."""


def _shown(result: PlanResult) -> Iterator[RenderableType]:
    """How close the chosen motion comes to each limit, the front, the chosen motion in other models, and the verdict."""
    from flexfmu.cosim.design.plans.planned_files import front_table, limits_table, robustness_table
    from flexfmu.cosim.reports.terminal import as_terminal_table

    chosen, given = result.chosen, result.given
    faster = "" if chosen is given else f", {chosen.time / given.time:.3g} of the given time"
    yield f"{result.goals.scene.name}: {chosen.candidate.label}: {chosen.time:.4g} s{faster}"
    yield as_terminal_table(limits_table(chosen), texts=("Unit", "Kept", "Where"))
    # motions over the whole front, the given and the chosen one and those to compare with among them
    table, count = front_table(result), len(result.table)
    if count > SHOWN:
        spread = {round(k * (count - 1) / (SHOWN - 3)) for k in range(SHOWN - 2)}
        labels = {each.candidate.label for each in (chosen, given)}
        always = (each not in result.front or each.candidate.label in labels for each in result.table)
        rows = [row for k, (row, there) in enumerate(zip(table.rows, always, strict=True)) if k in spread or there]
        title = table.title if len(rows) == count else f"{table.title}: {len(rows)} of {count}, all in front.csv"
        table = replace(table, title=title, rows=rows)
    yield as_terminal_table(table, texts=("Method", "Limits"))
    if result.robustness:
        yield as_terminal_table(robustness_table(result), texts=("Model", "Worst for", "Limits"))
    yield f"{result.verdict[0].upper()}{result.verdict[1:]}."
