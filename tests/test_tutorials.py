"""The tutorials are notebooks that run, and print what their pages show."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene, read_scene_text

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]\d+)?")


def notebook(path: Path) -> Any:
    """The notebook of a page, as the site has it."""
    module = run_path(str(ROOT / "generators" / "notebooks.py"))
    return pytest.importorskip("nbformat").from_dict(module["notebook"](path.read_text(encoding="utf-8")))


def printed(book: Any) -> list[str]:
    """What each cell of code prints."""
    return ["".join(each["text"] for each in cell.outputs) for cell in book.cells if cell.cell_type == "code"]


def assert_same(shown: str, found: str) -> None:
    """Equal words, and numbers that differ in the last digit at most."""
    assert NUMBER.split(shown) == NUMBER.split(found)
    for first, second in zip(NUMBER.findall(shown), NUMBER.findall(found), strict=True):
        mantissa, _, exponent = first.partition("e")
        digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
        assert float(second) == pytest.approx(float(first), abs=1.01 * digit), (shown, found)


@pytest.mark.slow
def test_there_are_eight() -> None:
    """First run, robot, controller, shaper, accuracy, plan, loop, identify: each in 10 to 25 cells and with what it prints."""
    assert len(TUTORIALS) == 8
    for path in TUTORIALS:
        book = notebook(path)
        pytest.importorskip("nbformat").validate(book)
        assert 10 <= len(book.cells) <= 25
        assert sum(map(bool, printed(book))) >= 4


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the notebooks' machinery
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: str(path.stem))
def test_tutorial_runs(path: Path, tmp_path: Path) -> None:
    """From the first cell to the last, without an error, and with the results on the page."""
    book = notebook(path)
    shown = printed(book)
    pytest.importorskip("nbclient").NotebookClient(
        book, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    for before, after in zip(shown, printed(book), strict=True):
        assert_same(before, after)


@pytest.mark.slow
def test_tasks_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of docs/how-to.md, one after the other, with fewer cases; and its Python in fewer than ten lines each."""
    text = (ROOT / "docs" / "how-to.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    log = run_scene(load_scene("barnard2012-6kg")).recording
    names = [f"joint{joint}.{signal}" for signal in ("reference.position", "torque") for joint in (1, 2)]
    time = np.arange(0.0, 0.6, 1e-3)
    columns = [time, *(np.interp(time, log.time, log[name].values) for name in names)]
    np.savetxt("log.csv", np.column_stack(columns), delimiter=",", header="time,q11,q21,M1,M2", comments="")
    scene, end = read_scene_text("barnard2012-6kg")[0], "[cosimulation]"
    (table,) = re.findall(r"^```toml\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    Path("bench.toml").write_text(
        scene.partition("[trajectory]")[0] + table + end + scene.partition(end)[2], encoding="utf-8"
    )

    for line in re.findall(r"^\$ flexfmu (.*)$", text, re.MULTILINE):
        assert "{" not in re.sub(r"'[^']*'", "", line), "a shell would expand the braces"
        arguments = shlex.split(line.replace("0:8:5", "0:8:2").replace("lhs:2000", "lhs:8"))
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, (line, result.output)
    written = "grid/sweep.csv grid/sweep.png many/sweep.csv share/results.mat comparison/comparison.html"
    assert [name for name in written.split() if not Path(name).is_file()] == []
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert all(len(block.splitlines()) < 10 for block in blocks)
    names_of_all: dict[str, Any] = {}
    for block in blocks:
        exec(block.replace("0:8:5", "0:8:2"), names_of_all)
    assert len(names_of_all["grid"]) == 24
