"""Trials of a tuning, each kept at once: what interrupts it loses at most those that are being made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from flexfmu.cosim.design.gains.trial import Study, Trial
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.many.journal import Journal

FILE = "journal.jsonl"
"""What is tuned in its first line, a trial in each other one."""


class TrialJournal:
    """The trials of a tuning in a folder.

    Args:
        folder: the folder; created if it doesn't exist.
        study: what is tuned.
        restart: whether the trials of another tuning are discarded; otherwise they are an error.

    Attributes:
        trials: values → trial, of earlier calls.

    Raises:
        InputError: the folder has another tuning.
        ResultsError: the folder can't be read or written.
    """

    def __init__(self, folder: Path, study: Study, *, restart: bool = False) -> None:
        self._lines, self.trials = Journal(folder / FILE, restart=restart), dict[tuple[float, ...], Trial]()
        head = json.loads(json.dumps(_about(study)))
        found = [_read(line) for _, line in self._lines.read()]
        if not found:
            self._lines.append(f"{json.dumps(head)}\n")
        elif found[0] != head:
            part = next((key for key in head if (found[0] or {}).get(key) != head[key]), "file")
            raise InputError(
                f"{folder} has another tuning (other {part}): give another folder with --out, or --restart to discard it"
            )
        for each in found[1:]:
            if each is not None:
                trial = Trial(tuple(each["values"]), each["figures"], each["message"])
                self.trials[trial.values] = trial

    def add(self, trial: Trial) -> None:
        """Keep a trial.

        Raises:
            ResultsError: the file can't be written.
        """
        line = {"values": trial.values, "figures": dict(trial.figures), "message": trial.message}
        self._lines.append(f"{json.dumps(line)}\n")


def _about(study: Study) -> dict[str, Any]:
    """What determines the trials of equal values."""
    names = sorted({part for goal in study.goals for part in goal.parts})
    return {
        "scene": study.scene.model_dump(mode="json", exclude_none=True),
        "keys": [each.key for each in study.over],
        "figures": names,
        "payload band": study.band,
    }


def _read(line: bytes) -> dict[str, Any] | None:
    """A line of the file; None for a torn one."""
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
