"""`flexfmu schema`: the scene file's JSON Schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from flexfmu.cosim.cli.console import print_text, show_note
from flexfmu.cosim.cli.options import option
from flexfmu.cosim.engine.files import write_whole


def schema(
    output: Annotated[
        Path | None, option("FILE.json", "File to write. Default: standard output.", "-o", "--output")
    ] = None,
) -> int:
    """JSON Schema of scene files, by which editors complete keys and show their units.

    Editors with taplo (Even Better TOML) read it where a scene file begins with a line [i]#:schema ./scene.schema.json[/i].
    """
    from flexfmu.model.scene.file import scene_schema

    text = scene_schema()
    if output is None:
        print_text(text)
        return 0
    write_whole(output, text)
    show_note(f"{output}: a scene file beside it begins with the line  #:schema ./{output.name}")
    return 0
