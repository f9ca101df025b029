"""`import flexfmu`: what it offers, how little it loads, and that it is the installed package from every working directory."""

from __future__ import annotations

import inspect
import os
import pickle
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.reports.modes_table import modes_along_path
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

ROOT = Path(__file__).parents[1]
FOLDERS = ("model", "fmu_build", "trajectories", "cosim", "benchmarks/hard_cases", "benchmarks/peers")
LIGHT = "barnard2012-0.1kg"


def python(*arguments: str, executable: str = sys.executable, cwd: Path | None = None) -> str:
    """Standard output of a Python process without warnings; its folder is on the path only as Python itself puts it there."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [executable, "-W", "error", *arguments]
    outcome = subprocess.run(
        command, capture_output=True, text=True, timeout=600, check=False, cwd=cwd, env=environment
    )
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def test_import_is_fast() -> None:
    """Importing the package loads none of the others; `benchmarks/speed.py` times it."""
    modules = python("-c", "import sys, flexfmu; print(*sys.modules)").split()
    heavy = {"numpy", "scipy", "casadi", "fmpy", "pydantic", "typer", "matplotlib", "importlib.metadata"}
    assert not heavy & set(modules)
    assert [name for name in modules if name.startswith("flexfmu")] == ["flexfmu"]


FUNCTIONS = sorted(name for name in flexfmu.__all__ if inspect.isfunction(getattr(flexfmu, name)))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented(name: str) -> None:
    """Every function has its arguments and errors in its docstring, and types for what it takes and returns."""
    function = getattr(flexfmu, name)
    text, signature = inspect.getdoc(function) or "", inspect.signature(function)
    assert function.__name__ == name
    assert "Raises:\n" in text
    assert all(re.search(rf"^    .*\b{parameter}\b.*:", text, re.MULTILINE) for parameter in signature.parameters)
    assert all(each.annotation is not each.empty for each in signature.parameters.values())
    assert signature.return_annotation is not signature.empty


def test_scene_by_name_by_path_or_itself(tmp_path: Path) -> None:
    """A Scene, a path, a path as text and a shipped name mean the same scene."""
    scene = load_scene(LIGHT)
    shipped = ROOT / "model" / "scene" / "scenes" / f"{LIGHT}.toml"
    file = tmp_path / "scene.toml"
    file.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    assert flexfmu.Scene is Scene
    assert all(flexfmu.reference_motion(source).scene == scene for source in (scene, file, str(file), LIGHT))


def test_calls_are_those_of_the_rooms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FMU, modes and a run with parameters and options are those of the functions that are called, also for a scene that leaves its
    effects open, with those that are chosen."""
    chosen = load_scene(LIGHT).replace({"trajectory.dwell": 0.0})
    wanted = {"tolerance": 0.01, "of": ["peak_position_error"]}
    left_open = chosen.replace({"effects": {"gravity": chosen.effects.gravity, "select": "auto", **wanted}})
    monkeypatch.setattr(
        "flexfmu.api.resolved_with_answer", lambda scene: (chosen if scene is left_open else scene, None)
    )
    cached = build_scene(chosen).path
    options = {"communication_step": 1e-3, "tolerance": 1e-4, "parameters": {"payload.mass": 0.2}}
    expected = run_scene(chosen, **options).recording["joint1.torque"].values
    for scene in (chosen, left_open):
        assert flexfmu.build(scene) == cached
        assert flexfmu.build(scene, str(tmp_path / "robot.fmu")).read_bytes() == cached.read_bytes()
        assert flexfmu.modes(scene, 3) == modes_along_path(plan(chosen), 3)
        found = flexfmu.run(scene, fmu=str(cached), **options)
        np.testing.assert_array_equal(found.recording["joint1.torque"].values, expected)
    peak = flexfmu.measure_run(found, companions=0)["peak_torque_1"].value
    assert peak == pytest.approx(abs(expected).max(), rel=1e-3)
    # runs pickle, with what their metrics need
    assert pickle.loads(pickle.dumps(found)).metrics.peak_torque_1 == found.metrics.peak_torque_1
    system = flexfmu.linearize(LIGHT, (0.0, 0.3), ["joint1.position"])
    assert system.output_labels == ["joint1_position"]
    assert system.nstates == 2 * (2 + len(flexfmu.modes(LIGHT, 3)[0].frequencies))


Installation = tuple[str, Path]
"""The interpreter of an environment with flexfmu in it, and the folder that holds the package, in whole or in its parts."""

PIP = ("--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")


@pytest.fixture(scope="module")
def clones(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two clones of the repository: one to install from, one that is called flexfmu."""
    if not (ROOT / "setup.py").is_file():
        pytest.skip("tests run away from the source tree")
    folder = tmp_path_factory.mktemp("clones")
    targets = folder / "robot", folder / "beside" / "flexfmu"
    for target in targets:
        for part in ("src", *FOLDERS):
            shutil.copytree(ROOT / part, target / part, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        for file in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
            shutil.copy(ROOT / file, target)
    return targets


@pytest.fixture(scope="module", params=["editable", "wheel"])
def installation(
    request: pytest.FixtureRequest, clones: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> Installation:
    """flexfmu in an environment of its own, which shares the dependencies of this one."""
    folder = tmp_path_factory.mktemp(request.param)
    venv.create(folder, with_pip=False)
    script = "import sys, sysconfig; print(sys.executable); print(sysconfig.get_path('purelib'))"
    (executable,) = (path for path in folder.glob("*/python*") if path.stem == "python")
    _, packages = python("-c", script, executable=str(executable)).splitlines()
    shared = (path for path in sys.path if path.endswith(("site-packages", "dist-packages")))
    (Path(packages) / "shared.pth").write_text("\n".join(shared), encoding="utf-8")
    install(str(executable), *(("--editable",) if request.param == "editable" else ()), str(clones[0]))
    return str(executable), clones[0] if request.param == "editable" else Path(packages) / "flexfmu"


def install(executable: str, *arguments: str) -> None:
    """Let pip install into another environment without any download."""
    command = [sys.executable, "-m", "pip", "--python", executable, "install", *PIP, "--ignore-installed", *arguments]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert outcome.returncode == 0, outcome.stderr


@pytest.mark.slow
@pytest.mark.parametrize("place", ["beside a clone", "in a clone", "deep in a clone", "beside a folder", "elsewhere"])
def test_every_working_directory(
    place: str, installation: Installation, clones: tuple[Path, Path], tmp_path: Path
) -> None:
    """The installed package is imported, never a clone or a folder of the same name that happens to be in the working directory."""
    (tmp_path / "namesake" / "flexfmu").mkdir(parents=True)
    cwd = {
        "beside a clone": clones[1].parent,
        "in a clone": clones[1],
        "deep in a clone": clones[1] / "cosim",
        "beside a folder": tmp_path / "namesake",
        "elsewhere": tmp_path,
    }[place]
    script = (
        "import flexfmu, flexfmu.model.scene.schema, flexfmu.cosim.cli.main, flexfmu.trajectories, flexfmu.fmu_build;"
        "print(flexfmu.load_scene('barnard2012-6kg').name);"
        "print(flexfmu.__file__, flexfmu.model.scene.schema.__file__, flexfmu.cosim.cli.main.__file__, flexfmu.trajectories.__file__,"
        " flexfmu.fmu_build.__file__, sep='\\n')"
    )
    executable, package = installation
    name, *files = python("-c", script, executable=executable, cwd=cwd).splitlines()
    assert name == "barnard2012-6kg"
    assert all(Path(file).resolve().is_relative_to(package.resolve()) for file in files), files
    shown = python("-m", "flexfmu", "--version", executable=executable, cwd=cwd)
    assert shown == f"flexfmu {flexfmu.__version__}\n"


@pytest.mark.slow
def test_wheel_holds_every_file(clones: tuple[Path, Path], tmp_path: Path) -> None:
    """A wheel has all modules, templates, C sources, scenes and data of the source tree, and nothing else."""
    python("-m", "pip", "wheel", *PIP, "--wheel-dir", str(tmp_path), str(clones[0]))
    (wheel,) = tmp_path.glob("*.whl")
    packed = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    places = {folder: clones[1] / folder for folder in FOLDERS} | {"": clones[1] / "src" / "flexfmu"}
    needed = {
        "/".join(filter(None, ("flexfmu", folder, path.relative_to(source).as_posix())))
        for folder, source in places.items()
        for path in source.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packed == needed


def test_help_of_the_module() -> None:
    """`python -m flexfmu` is the command line, under the name that was typed."""
    assert "Usage: python -m flexfmu [OPTIONS] COMMAND" in python("-m", "flexfmu", "--help")
