"""Writes the list of commands in docs/command-line.md from the help: `python generators/command_line_page.py`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from flexfmu.cosim.cli.main import app

PAGE = Path(__file__).parents[1] / "docs" / "command-line.md"
START = "<!-- from here on written by generators/command_line_page.py -->\n"


def reference() -> str:
    """Every command with its arguments and options, as Markdown."""
    group: Any = typer.main.get_command(app)
    return "\n".join(line for name, command in group.commands.items() for line in _section(name, command))


def _section(name: str, command: Any) -> Iterator[str]:
    """The lines of a command."""
    context = command.make_context(name, [], resilient_parsing=True)
    usage = " ".join(each.metavar for each in command.params if each.param_type_name == "argument")
    yield f"\n### `flexfmu {f'{name} {usage}'.strip()}`\n"
    yield from (f"{' '.join(paragraph.split())}\n" for paragraph in command.help.split("\n\n"))
    yield "| Argument or option | Meaning |\n| --- | --- |"
    for parameter in command.get_params(context):
        if parameter.name != "help":
            # bars and angles would be Markdown's
            taken, meaning = (
                " ".join(part.split()).replace("|", " or ") for part in parameter.get_help_record(context)
            )
            yield f"| `{taken}` | {meaning.replace('<', '&lt;')} |"


def main() -> None:
    """Write the page."""
    text = PAGE.read_text(encoding="utf-8").partition(START)[0]
    PAGE.write_text(f"{text}{START}{reference()}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
