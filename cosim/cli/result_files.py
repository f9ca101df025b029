"""Files of recorded signals in a folder of results, in the formats that are asked for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.engine.files import RESULTS, OutputFolder

if TYPE_CHECKING:
    from flexfmu.cosim.engine.results import Recording

LONGEST = 80
"""Characters of a folder's name that are for changes of the scene."""


def check_formats(formats: Sequence[str]) -> None:
    """Check formats before a run.

    Raises:
        InputError: there is no such format, or its library isn't installed.
    """
    from flexfmu.cosim.engine.results import check_format  # numpy, which help doesn't load

    for name in formats:
        check_format(name)


def write_results(
    folder: OutputFolder, recording: Recording, formats: Sequence[str], about: Mapping[str, str]
) -> list[str]:
    """Write the recording in these formats as ``results.<format>``, remove those of an earlier run in others; return their names.

    Raises:
        ResultsError: a file can't be written, with the system's reason.
    """
    from flexfmu.cosim.engine.results import FORMATS

    for name in FORMATS:
        if name in formats:
            recording.write(folder.path / f"results.{name}", about)
        else:
            folder.remove(f"results.{name}")
    return [f"results.{name}" for name in formats]


def files_sentence(files: Sequence[str], folder: Path) -> str:
    """Return where the files are."""
    return f"{', '.join(files[:-1])} and {files[-1]} are in {folder}"


def usual_folder(name: str, settings: Sequence[str] | None, ending: str = "") -> Path:
    """Return the folder of a scene's results: ``results/<name>``; with changes by ``--set`` one of its own, which has them in its name."""
    if not settings:
        return RESULTS / f"{name}{ending}"
    changes = re.sub(r"[^\w.+=-]+", "_", ",".join(settings)).strip("_")
    if len(changes) > LONGEST:
        changes = f"{changes[:LONGEST]}-{sha256(','.join(settings).encode()).hexdigest()[:8]}"
    return RESULTS / f"{name}{ending}-{changes}"
