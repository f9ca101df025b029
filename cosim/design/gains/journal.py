"""Trials of a tuning, each kept at once: what interrupts it loses at most those that are being made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexfmu.cosim.design.gains.trial import Study, Trial
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import OutputFolder

FILE = "journal.jsonl"
"""What is tuned in its first line, a trial in each other one."""


class Journal:
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
        OutputFolder(folder).prepare()
        self._path, self.trials = folder / FILE, dict[tuple[float, ...], Trial]()
        head = json.loads(json.dumps(_about(study)))
        try:
            lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.exists() and not restart else []
        except OSError as error:
            raise ResultsError(f"can't read {self._path}: {error.strerror or error}") from error
        if lines and (found := _read(lines[0])) != head:
            part = next((key for key in head if (found or {}).get(key) != head[key]), "file")
            raise InputError(
                f"{folder} has another tuning (other {part}): give another folder with --out, or --restart to discard it"
            )
        whole = [found for line in lines[1:] if (found := _read(line)) is not None]
        for each in whole:
            trial = Trial(tuple(each["values"]), each["figures"], each["message"])
            self.trials[trial.values] = trial
        # without what was torn
        self._write("w", head, *whole)

    def add(self, trial: Trial) -> None:
        """Keep a trial.

        Raises:
            ResultsError: the file can't be written.
        """
        self._write("a", {"values": trial.values, "figures": dict(trial.figures), "message": trial.message})

    def _write(self, mode: str, *lines: Mapping[str, Any]) -> None:
        try:
            with self._path.open(mode, encoding="utf-8") as file:
                file.writelines(f"{json.dumps(line)}\n" for line in lines)
        except OSError as error:
            raise ResultsError(f"can't write {self._path}: {error.strerror or error}") from error


def _about(study: Study) -> dict[str, Any]:
    """What determines the trials of equal values."""
    names = sorted({part for goal in study.goals for part in goal.parts})
    return {
        "scene": study.scene.model_dump(mode="json", exclude_none=True),
        "keys": [each.key for each in study.over],
        "figures": names,
        "payload band": study.band,
    }


def _read(line: str) -> dict[str, Any] | None:
    """A line of the file; None for a torn one."""
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
