"""Files of a tuning: the tuned scene, the table of all trials, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import tomlkit

from flexfmu.cosim.design.gains.tuner import TuneResult
from flexfmu.cosim.design.scene_files import changed_document, toml_item
from flexfmu.cosim.engine.files import OutputFolder, write_whole
from flexfmu.cosim.reports.terminal import to_json
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.keys import full_key, value_at


def summary(result: TuneResult) -> dict[str, Any]:
    """Return the tuning as plain data, in SI units.

    Keys:
        scene: name.
        keys: for each key low, high, given (None where the joints differ) and tuned.
        minimise: name, unit, given and tuned.
        conditions: text, unit, limit, given and tuned of each; None for an infinite margin too.
        within_limits, interrupted, trials: whether the best trial keeps all limits, whether Ctrl-C ended the tuning, and the number of
            its trials.
    """
    study, given, best = result.study, result.given, result.best
    return {
        "scene": study.scene.name,
        "keys": {
            each.key: {"low": each.low, "high": each.high, "given": own, "tuned": result.values.get(each.key, own)}
            for each, own in zip(study.over, study.given(), strict=True)
        },
        "minimise": {
            "name": study.minimise.name,
            "unit": study.minimise.unit,
            "given": _finite(study.minimise.of(given.figures)),
            "tuned": _finite(study.minimise.of(best.figures)),
        },
        "conditions": [
            {
                "text": each.text,
                "unit": each.goal.unit,
                "limit": each.limit.limit,
                "given": _finite(each.closest(given.figures)),
                "tuned": _finite(each.closest(best.figures)),
            }
            for each in study.conditions
        ],
        "payload_band": study.band,
        "within_limits": result.is_feasible,
        "interrupted": result.interrupted,
        "trials": len(result.trials),
    }


def _finite(value: float | None) -> float | None:
    """Return the value; None for one that JSON doesn't have."""
    return value if value is not None and isfinite(value) else None


def write_tuning(result: TuneResult, folder: Path) -> list[Path]:
    """Write trials and figures into a folder; return the files, ``tune.csv`` and ``tune.json``.

    Raises:
        ResultsError: a file can't be written.
    """
    out = OutputFolder(folder)
    out.prepare()
    return [out.write("tune.csv", result.to_csv()), out.write("tune.json", to_json(summary(result)))]


def write_tuned(
    result: TuneResult, target: Path, source: str | Path | None = None, changes: Mapping[str, Any] | None = None
) -> Path:
    """Write the tuned scene.

    Args:
        result: the tuning.
        target: the new file.
        source: the scene file, whose comments stay; None for a file without comments.
        changes: dotted key → value that the scene differed from the file in.

    Raises:
        ResultsError: the file can't be written.
        SceneError: the file doesn't give the scene that was tuned.
    """
    if source is None:
        document = tomlkit.document()
        for key, value in result.scene.model_dump(mode="json", exclude_none=True, exclude_defaults=True).items():
            document.add(key, toml_item(value))
    else:
        document = changed_document(source, target, {**(changes or {}), **_whole(result)})
    write_whole(target, tomlkit.dumps(document))
    load_scene(target)
    return target


def _whole(result: TuneResult) -> dict[str, Any]:
    """The tuned keys with their whole values: one number for both joints, or both."""
    data = result.scene.model_dump(mode="json", exclude_none=True)
    found = {}
    for key in result.values:
        whole = full_key(data, key)
        if whole.endswith("]"):
            whole = whole.rpartition("[")[0]
        value = value_at(data, whole)
        same = isinstance(value, list) and len(value) == 2 and value[0] == value[1]
        found[whole] = value[0] if same else value
    return found
