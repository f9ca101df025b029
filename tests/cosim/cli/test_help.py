"""The help: every command and option says what it takes and what its default is; mistyped ones are suggested."""

from __future__ import annotations

import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.model.scene.file import shipped_scenes

GROUP: Any = typer.main.get_command(app)
ROOT = Path(__file__).parents[3]


def parameters() -> Iterator[tuple[str, Any, Any]]:
    """The name of each command with its context and each of its parameters."""
    for name, command in GROUP.commands.items():
        context = command.make_context(name, [], resilient_parsing=True)
        yield from ((name, context, each) for each in command.get_params(context))


OPTIONS = [(name, context, each) for name, context, each in parameters() if each.param_type_name == "option"]


def test_every_option_and_argument_names_what_it_takes_and_its_default() -> None:
    """A word in capitals, the choices, or nothing for a flag; arguments have theirs. The default is there as a text, or by what
    click adds; flags that switch something on are off."""
    for name, context, option in parameters():
        record = option.get_help_record(context)
        assert record is not None
        assert record[1]
        if option.param_type_name == "argument":
            assert re.fullmatch(r"(SCENE|RUN|(FILE|LOG)\.\w+)(\.\.\.)? <[\w\[\]]+>", record[0])
            continue
        assert option.name == "help" or "default:" in record[1].lower(), f"{name} {option.opts[0]}"
        if not option.is_flag:
            assert re.search(r"--[\w-]+ ([A-Z]|<[\w-]+\|)", record[0]), f"{name} {record}"


@pytest.mark.parametrize("width", [60, 120])
def test_help_fits_the_terminal(width: int) -> None:
    """No line is longer than the terminal is wide, nothing is shortened to an ellipsis."""
    for name in ("", *GROUP.commands):
        result = CliRunner().invoke(app, [*filter(None, [name]), "--help"], terminal_width=width)
        assert result.exit_code == 0
        assert max(map(len, result.stdout.splitlines())) <= width
        # "RUN..." is an argument that may be there several times
        assert not re.search(r"…|[a-z,]\.\.\.(?!\])", result.stdout)


def test_the_list_of_commands_has_a_whole_sentence_each() -> None:
    """The first sentence of each command's help."""
    text = " ".join(CliRunner().invoke(app, ["--help"]).stdout.split())
    for name, command in GROUP.commands.items():
        assert f"{name} {' '.join(command.help.partition(chr(10))[0].split())}" in text


@pytest.mark.parametrize(
    ("arguments", "suggestion"),
    [
        (["swep"], "'sweep'"),
        (["mode"], "'modes'"),
        (["run", "barnard2012-6kg", "--fromat", "csv"], "--format"),
        (["modes", "barnard2012-6kg", "--pose", "3"], "--poses"),
        (["new", "x.toml", "--form", "barnard2012-6kg"], "--from"),
    ],
)
def test_mistyped_commands_and_options_are_suggested(arguments: list[str], suggestion: str) -> None:
    """Usage is wrong, status 2, and the nearest is named."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert suggestion in result.stderr
    assert result.stdout == ""


def test_the_page_is_the_help() -> None:
    """docs/commands.md has every command and option as the help has them; `python generators/command_line_page.py` writes it."""
    namespace = runpy.run_path(str(ROOT / "generators" / "command_line_page.py"))
    written = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert written == namespace["written"](written), "run: python generators/command_line_page.py"
    assert all(
        f"| `{option.get_help_record(context)[0]}".partition("|")[0] in written for _, context, option in OPTIONS
    )
    # reading the scenes' names would load their schema for each help
    for named in re.findall(r"shipped scene: ([\w., -]*\w)", written):
        assert {*named.split(", ")} == {*shipped_scenes()}


@pytest.mark.parametrize(("typed", "expected"), [("flexfmu mar", ["margins"]), ("flexfmu run --stop", ["--stop-time"])])
def test_shells_complete_commands_and_options(typed: str, expected: list[str]) -> None:
    """What `flexfmu --install-completion` writes for bash asks the command itself, in this way."""
    asked = {"_FLEXFMU_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    result = CliRunner().invoke(app, [], prog_name="flexfmu", env=asked)
    assert (result.exit_code, result.stdout.split()) == (0, expected)
