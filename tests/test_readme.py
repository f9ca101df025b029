"""README and docs tell the truth: their code runs, their commands exist, their names are complete and their figures come out."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.variables import parameter_names
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, METRICS, definition, display, display_error
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.modes_table import modes_along_path
from flexfmu.cosim.reports.summary import summarise
from flexfmu.cosim.studies.paper.tables import blend_length, case_scene, peak_task_acceleration, printed_table
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import parse_scene

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
POLYNOMIAL = "7th order polynomial"


def blocks(language: str, text: str = README) -> list[str]:
    """Fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def page(name: str) -> str:
    """A page of docs/."""
    return (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")


def rows(text: str) -> list[list[str]]:
    """Cells of the body of all Markdown tables in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    tables = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    return [
        row
        for row, following in zip(tables, [*tables[1:], [""]], strict=True)
        if set(row[0]) - set("-:") and (not following[0] or set(following[0]) - set("-:"))
    ]


def table_row(text: str, label: str) -> list[str]:
    """Cells of the row that begins so."""
    return next(row for row in rows(text) if row[0].startswith(label))


def agrees(text: str, value: float) -> bool:
    """Whether a printed figure is the value, rounded to its digits."""
    _, _, decimals = text.partition("e")[0].partition(".")
    return abs(float(text) - value) <= 0.51 * 10.0 ** -len(decimals)


@pytest.fixture(scope="module")
def run() -> Run:
    """The 6 kg scene."""
    return run_scene(load_scene("barnard2012-6kg"))


@pytest.fixture(scope="module")
def metrics(run: Run) -> dict[str, Metric]:
    """Its metrics."""
    return dict(measure_run(run))


@pytest.mark.slow
def test_python_blocks_run(tmp_path: Path) -> None:
    """The Python blocks, one after the other, are a script that works without a warning."""
    script = tmp_path / "readme.py"
    script.write_text("\n".join(blocks("python")), encoding="utf-8")
    command = [sys.executable, "-W", "error", str(script)]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, cwd=tmp_path)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert outcome.stdout.startswith("the simulation reached its stop time ")
    assert (tmp_path / "results.csv").is_file()


@pytest.mark.parametrize(
    "name", ["README.md", *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md")))]
)
def test_commands_exist(name: str) -> None:
    """Every command that a text shows is one of the program's, with these options."""
    text = (ROOT / name).read_text(encoding="utf-8")
    commands: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
    typed = [line for block in blocks("console", text) for line in block.splitlines() if line.startswith("$ flexfmu")]
    typed += [f"$ {line}" for line in re.findall(r"`(flexfmu [a-z][^`]*)`", text)]
    for line in typed:
        _, command, *arguments = shlex.split(
            line.removeprefix("$ ").translate(str.maketrans("", "", "[]")), comments=True
        )
        parameters = commands[command].params
        options = {option for each in parameters for option in (*each.opts, *each.secondary_opts)} | {"--help"}
        assert {re.sub("=.*", "", each) for each in arguments if re.match("-[-a-z]", each)} <= options, line


def test_every_command_is_named() -> None:
    """In the README's table, and with its options in docs/commands.md."""
    for name in get_command(app).commands:  # type: ignore[attr-defined]
        assert f"`flexfmu {name}" in README
        assert f"## `flexfmu {name}" in page("commands"), name


def test_files_and_targets_exist() -> None:
    """Links lead to files, scripts that are to be run exist, and so do the targets of make; the README is short, and every example is listed."""
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", README):
        assert (ROOT / link).exists(), link
    for text in (README, *(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))):
        for script in re.findall(r"`python (?!-m )([^` ]+/[^` ]+)", text):
            assert (ROOT / script).is_file(), script
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^    make (\w+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    assert (ROOT / "docs" / "overview.png").stat().st_size < 300_000
    assert (ROOT / "docs" / "live.webp").stat().st_size < 1_000_000
    assert len(README.splitlines()) < 250, "what few users need is in docs/"
    for script in (ROOT / "examples").glob("*.py"):
        assert f"](../examples/{script.name})" in page("how-to"), script.name


def test_scene_file_is_the_shipped_one() -> None:
    """The explained scene file is the 6 kg scene to the last value."""
    (text,) = blocks("toml")
    assert parse_scene(tomllib.loads(text), "README.md") == load_scene("barnard2012-6kg")


def test_metrics_and_summary_are_complete(run: Run, metrics: dict[str, Metric]) -> None:
    """The tables name every metric with its unit, and every key of summary.json."""
    for name, info in ALL_METRICS.items():
        row = next(row for row in rows(page("metrics")) if f"`{name}`" in row[0])
        units = row[1].split(", ")
        assert info.unit == units[row[0].split(", ").index(f"`{name}`") if len(units) > 1 else 0]
    keys = " ".join(row[0] for row in rows(page("metrics")))
    assert all(f"`{key}`" in keys for key in summarise(run, metrics))


def test_variables_of_the_fmu(run: Run) -> None:
    """All parameters are named, and all inputs and outputs are of the named kinds."""
    text = page("fmu")
    description = open_fmu(run.fmu_path).description
    assert all(f"`{name}`" in text for name in parameter_names(description))
    for variable in description.modelVariables:
        name = re.sub(r"link2(\d)", r"link1\1", variable.name.replace("joint2", "joint1").replace(".y", ".x"))
        kind = re.sub(r"link\d\d\.(bending|axial)\[\d\]", "link11.bending[1]", name)
        assert f"`{variable.name}`" in text or f"`{kind}`" in text, variable.name


def test_metrics_of_the_quick_start(metrics: dict[str, Metric]) -> None:
    """What `flexfmu run` is shown to print is what it prints."""
    shown = blocks("console")[0]
    named = {name: info.label for name, info in METRICS.items() if info.label in shown}
    assert len(named) >= 6
    for name, label in named.items():
        found = metrics[name]
        row = re.search(rf"{label} +{name} +(.+)\n", shown)
        assert row, label
        value, *unit, bound = row[1].split()
        assert display(name, found.value, error=found.error).split()[1:] == unit
        info, limit = definition(name), 2.0 * float(display_error(name, found.value, found.error))
        assert float(bound) == pytest.approx(limit / 2.0, rel=0.5)
        assert found.value is not None
        assert abs(float(value) - info.displayed(found.value)) < limit, label


def test_modes_table() -> None:
    """The shown frequencies are those of the scene."""
    lines = next(block for block in blocks("console", page("commands")) if "modes" in block).splitlines()
    shown = [line for line in lines if re.match(r" *\d\.\d+ ", line)]
    poses = modes_along_path(plan(load_scene("barnard2012-6kg")), 3)
    for line, pose in zip(shown, poses, strict=True):
        values = [pose.s, pose.x, pose.y, *pose.frequencies[:6]]
        assert all(agrees(*pair) for pair in zip(line.split(), values, strict=True)), line


def test_paper_figures_of_the_trajectories_and_frequencies() -> None:
    """Lengths, accelerations and frequencies beside the paper's, reproduced or not."""
    text = page("references")
    for label, computed in {
        "Table 2: length of the Lamé": 1e3 * blend_length("Lamé"),
        "Table 2: length of the clothoid": 1e3 * blend_length("Clothoid"),
        "Table 5: acceleration, polynomial": peak_task_acceleration(POLYNOMIAL, "Lamé"),
        "Table 5: acceleration, bang-bang": peak_task_acceleration("Bang-bang", "Clothoid"),
    }.items():
        assert agrees(table_row(text, label)[2], computed), label
    for payload in ("6", "0.1"):
        frequencies = [
            pose.frequencies[0] for pose in modes_along_path(plan(load_scene(f"barnard2012-{payload}kg")), 11)
        ]
        shown = table_row(text, f"first natural frequency, {payload} kg")[2].split(" to ")
        assert all(agrees(*pair) for pair in zip(shown, (min(frequencies), max(frequencies)), strict=True))


@pytest.mark.slow
def test_paper_figures_of_the_simulations(metrics: dict[str, Metric]) -> None:
    """Figures of Tables 7, 8, 9 and 11, each with its difference from the printed one."""
    text = page("references")

    def measured(scene: str, profile: str, curve: str) -> dict[str, Metric]:
        return dict(measure_run(run_scene(case_scene(scene, profile, curve))))

    light = measured("barnard2012-0.1kg", POLYNOMIAL, "Lamé")
    polar = measured("barnard2012-6kg", "1/8 Trapezoidal", "Polar")
    extended = measured("barnard2012-6kg", POLYNOMIAL, "Clot. Ext")
    for label, found, metric, scale in [
        ("Table 7: torque", metrics, "peak_torque_1", 1.0),
        ("Table 7: RMS", metrics, "rms_acceleration_error", 1.0),
        ("Table 7: modal deflection [mm]", metrics, "peak_modal_deflection_1", 1e3),
        ("Table 9: torque", light, "peak_torque_1", 1.0),
        ("Table 9: RMS", light, "rms_acceleration_error", 1.0),
        ("Table 11: end position error, polynomial, Lamé", metrics, "end_position_error", 1e3),
        ("Table 7: modal deflection, 1/8", polar, "peak_modal_deflection_1", 1e3),
        ("Table 11: end position error, polynomial, extended", extended, "end_position_error", 1e3),
        ("Table 8: end position error", metrics, "end_position_error", 1e3),
    ]:
        _, printed, shown, remark = table_row(text, label)
        value = found[metric].value
        assert value is not None
        assert agrees(shown, scale * value), label
        if remark.endswith(" %"):
            difference = float(remark.removesuffix(" %").replace("−", "-"))
            assert difference == pytest.approx(100.0 * (scale * value / float(printed) - 1.0), abs=0.0051), label


def test_printed_figures_are_the_paper_s() -> None:
    """No printed figure that isn't in the tables of the paper as they are kept."""
    for row in rows(page("references")):
        found = re.match(r"Table (\d+):", row[0])
        if found:
            table = printed_table(f"table-{int(found.group(1)):02d}")
            assert any(row[1] in figures for quantity in table.quantities for figures in quantity.values), row


@pytest.mark.slow
def test_accuracy_table(run: Run) -> None:
    """The achieved errors at 1 ms are of the stated size, and the integrator needs about the stated steps."""
    scene, fmu = run.scene, build_scene(run.scene).path
    exact = run_scene(scene, fmu_path=fmu, communication_step=1e-3, tolerance=1e-12)
    peak = measure_run(run)["peak_torque_1"].value
    assert peak is not None
    stated = [row for row in rows(page("speed")) if row[0] == "1 ms"]
    assert len(stated) == 3
    for _, tolerance, _, _, steps, _, torque, _ in stated:
        result = run_scene(scene, fmu_path=fmu, communication_step=1e-3, tolerance=float(tolerance))
        error = abs(result.recording["joint1.torque"].values - exact.recording["joint1.torque"].values).max() / peak
        assert 0.1 * float(torque) < error < 10.0 * float(torque)
        assert result.health.statistics["steps"] == pytest.approx(int(steps), rel=0.2)
