"""Writes arguments and options of each command in docs/commands.md from the help: `python generators/command_line_page.py`.

What the page says besides stands between these parts, which are marked by comments.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from flexfmu.cosim.cli.main import app

PAGE = Path(__file__).parents[1] / "docs" / "commands.md"
PART = re.compile(r"^<!-- (?P<name>[\w-]+) -->\n.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)
HEAD = "| Argument or option | Meaning |\n| --- | --- |"


def written(text: str) -> str:
    """The page with its marked parts written anew; one for each command, in any order, and one for what commands share."""
    group: Any = typer.main.get_command(app)
    rows = {name: list(_rows(name, command)) for name, command in group.commands.items()}
    counts = Counter(row for each in rows.values() for row in each)
    # a row that three commands have is theirs in common
    common = [row for row, count in counts.items() if count > 2]
    parts = {"common": "\n".join(["\n## Options that many commands have\n", HEAD, *common])}
    for name, command in group.commands.items():
        parts[name] = "\n".join(_section(name, command, [row for row in rows[name] if row not in common]))
    assert sorted(each["name"] for each in PART.finditer(text)) == sorted(parts)
    return PART.sub(lambda part: f"<!-- {part['name']} -->\n{parts[part['name']]}\n\n<!-- end -->", text)


def _section(name: str, command: Any, rows: list[str]) -> Iterator[str]:
    """The lines of a command."""
    usage = " ".join(each.metavar for each in command.params if each.param_type_name == "argument")
    yield f"\n## `flexfmu {f'{name} {usage}'.strip()}`\n"
    paragraphs = [" ".join(paragraph.split()) for paragraph in command.help.split("\n\n")]
    # [i] and [/i] are the terminal's
    yield "\n\n".join(re.sub(r"\[/?i\]", "`", paragraph) for paragraph in paragraphs)
    if rows:
        yield f"\n{HEAD}"
        yield from rows


def _rows(name: str, command: Any) -> Iterator[str]:
    """Arguments and options of a command, as rows of a table."""
    context = command.make_context(name, [], resilient_parsing=True)
    for parameter in command.get_params(context):
        if parameter.name != "help":
            # bars and angles would be Markdown's
            taken, meaning = (
                " ".join(part.split()).replace("|", " or ") for part in parameter.get_help_record(context)
            )
            yield f"| `{taken}` | {meaning.replace('<', '&lt;')} |"


def main() -> None:
    """Write the page."""
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
