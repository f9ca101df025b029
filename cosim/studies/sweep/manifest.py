"""What is swept in a folder: a sweep with other scene, cases or metrics doesn't continue it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.studies.sweep.cases import Cases, Grid, Sample, Span, digest
from flexfmu.cosim.studies.sweep.work import Job

NAMED = 20
"""Values of a key that the manifest lists; of more it has the ends and a hash."""


def make_manifest(job: Job, units: Mapping[str, str]) -> dict[str, Any]:
    """What is swept: a sweep with another one doesn't continue this one."""
    return {
        "flexfmu": version("flexfmu"),
        "scene": job.scene.model_dump(mode="json", exclude_none=True),
        "cases": _described(job.cases),
        "metrics": list(job.metrics.names),
        "record": None if job.record is None else {"signals": list(job.record.names or ()), "step": job.record.step},
        "units": dict(units),
    }


def _described(cases: Cases) -> dict[str, Any]:
    """The cases for the manifest."""
    found: dict[str, Any] = {"count": len(cases), "keys": list(cases.keys)}
    if isinstance(cases, Grid):
        found["values"] = {key: _listed(level) for key, level in zip(cases.keys, cases.levels, strict=True)}
    if isinstance(cases, Sample):
        found |= {"sample": cases.method, "seed": cases.seed}
        found["values"] = {
            key: f"{each.low!r}:{each.high!r}" if isinstance(each, Span) else _listed(each)
            for key, each in zip(cases.keys, cases.values, strict=True)
        }
    return found | {"hash": digest(cases)}


def _listed(values: Sequence[Any]) -> Any:
    """A list of values, or the ends of a long one."""
    return list(values) if len(values) <= NAMED else f"{len(values)} values from {values[0]!r} to {values[-1]!r}"


def read_manifest(path: Path) -> dict[str, Any] | None:
    """What is swept in a folder; None if nothing is.

    Raises:
        ResultsError: the file can't be read.
    """
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise ResultsError(f"can't read {path}: {error}; use --restart, or another --out") from error
    return found


def difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """What differs between two sweeps, the first few differences."""
    one, two = _flat(before), _flat(after)
    found = [
        f"{key} was {_short(one.get(key))}, now {_short(two.get(key))}"
        for key in {**one, **two}
        if one.get(key) != two.get(key)
    ]
    rest = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return ", ".join(found[:3]) + rest


def _flat(data: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted keys of nested tables → values."""
    if not isinstance(data, Mapping):
        return {prefix: data}
    return {
        key: value
        for name, each in data.items()
        for key, value in _flat(each, f"{prefix}.{name}" if prefix else name).items()
    }


def _short(value: Any) -> str:
    """A value for a message."""
    text = "not there" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."
