"""Commands in a real terminal of 60, 80 and 120 columns, and in a pipe."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
from collections.abc import Iterator

import pytest

FLEXFMU = (sys.executable, "-c", "from flexfmu.cosim.cli.main import main; main()")
MODES = ("modes", "barnard2012-6kg", "--poses", "3", "--set", "effects.proximal_bending=2")
STYLES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def without_width() -> dict[str, str]:
    """The environment without what overrides the terminal's width or style."""
    removed = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
    return {key: value for key, value in os.environ.items() if key not in removed} | {"TERM": "xterm-256color"}


def in_terminal(columns: int, *arguments: str) -> str:
    """What a command prints into a terminal with so many columns, styles included; standard error is elsewhere."""
    fcntl, pty, termios = (pytest.importorskip(name) for name in ("fcntl", "pty", "termios"))
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    command = [*FLEXFMU, *arguments]
    with subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=subprocess.DEVNULL, env=without_width()
    ) as process:
        os.close(theirs)
        text = b"".join(chunks(ours)).decode().replace("\r\n", "\n")
    os.close(ours)
    assert process.returncode == 0
    return text


def chunks(terminal: int) -> Iterator[bytes]:
    """What is written into the terminal until its last user ends."""
    while True:
        try:
            chunk = os.read(terminal, 65536)
        except OSError:  # Linux' sign of the end
            return
        if not chunk:
            return
        yield chunk


@pytest.fixture(scope="module")
def frequencies() -> list[str]:
    """The numbers of the table, from JSON."""
    outcome = subprocess.run([*FLEXFMU, *MODES, "--json"], capture_output=True, text=True, check=True, timeout=60)
    return [f"{f:.2f}" for pose in json.loads(outcome.stdout)["poses"] for f in pose["frequencies"][:6]]


@pytest.mark.parametrize("columns", [60, 80, 120])
def test_numbers_are_whole_in_a_terminal(columns: int, frequencies: list[str]) -> None:
    """Every frequency can be read, no line is wrapped by the terminal."""
    text = in_terminal(columns, *MODES)
    lines = STYLES.sub("", text).splitlines()
    assert text != STYLES.sub("", text), "the title is bold"
    assert max(map(len, lines)) <= columns
    assert "…" not in text
    words = [word for line in lines for word in line.split()]
    assert all(words.count(number) >= frequencies.count(number) for number in frequencies)
    assert len(frequencies) == 18


def test_a_pipe_has_neither_styles_nor_the_width_of_a_terminal(frequencies: list[str]) -> None:
    """Whatever the terminal that the command is started from: one table of 120 columns, sentences on one line."""
    environment = without_width() | {"COLUMNS": "60"}
    text = subprocess.run(
        [*FLEXFMU, *MODES], capture_output=True, text=True, check=True, timeout=60, env=environment
    ).stdout
    assert "\x1b" not in text
    assert text.count("─\n") + text.count("─ \n") == 1
    assert set(frequencies) <= set(text.split())
    assert text.splitlines()[-1].startswith("The lowest 6 of ")
