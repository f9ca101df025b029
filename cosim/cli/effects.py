"""`flexfmu effects`: every effect with what it is worth and what it costs, and the cheapest set within a tolerance."""

from __future__ import annotations

from typing import Annotated

from flexfmu.cosim.cli.console import load_changed, print_rich, print_text, progress
from flexfmu.cosim.cli.options import JsonOption, SceneArgument, SetOption, flag, option
from flexfmu.cosim.reports.text import to_json


def effects(
    scene: SceneArgument,
    tolerance: Annotated[float | None, option("RELATIVE", "Largest error. Default: the scene's, or 0.01.")] = None,
    of: Annotated[
        list[str] | None, option("METRIC", "A metric to hold; may be repeated. Default: the scene's, or three of them.")
    ] = None,
    check: Annotated[
        bool, flag("Run the chosen set beside the next richer ones; builds their FMUs. Default: don't.", "--check")
    ] = False,
    settings: SetOption = None,
    json: JsonOption = False,
) -> int:
    """Choose the cheapest elastic effects within a tolerance; shows what each is worth and what it costs."""
    from flexfmu.cosim.design.effects.study import check_choice, comparison_table, report, study_data, study_effects

    robot = load_changed(scene, settings)
    with progress() as show:
        study = study_effects(robot, tolerance, tuple(of or []), show)
        comparisons = check_choice(study, show=show) if check else ()
    # standard output
    if json:
        print_text(to_json(study_data(study, comparisons)))
    else:
        print_rich(*report(study), *([comparison_table(comparisons)] if check else ()))
    return 0
