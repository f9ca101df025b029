"""What a release holds: complete archives, a description whose links lead somewhere, and one version."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from email import message_from_bytes
from email.message import Message
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PLACES = {"CITATION.cff": r'^version: "?([\d.]+)', "conda/recipe.yaml": r'^  version: "?([\d.]+)'}
"""Files that say the version beside pyproject.toml, and how."""

pytestmark = pytest.mark.skipif(not (ROOT / "setup.py").is_file(), reason="tests run away from the source tree")


def listed() -> set[str]:
    """Files that git knows or would take."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    outcome = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if outcome.returncode != 0:
        pytest.skip("no git repository here")
    return {name for name in outcome.stdout.splitlines() if (ROOT / name).is_file()}


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, built from a copy that also holds what must stay outside, and unpacked."""
    copy, target = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("unpacked")
    outside = {"results/run.csv", "cosim/__pycache__/a.pyc", "robot.fmu", ".venv/pyvenv.cfg", "build/a.txt"}
    for name in listed() | outside:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, copy / name)
        else:
            (copy / name).touch()
    script = "from setuptools.build_meta import build_sdist; build_sdist('dist')"
    subprocess.run([sys.executable, "-c", script], cwd=copy, capture_output=True, check=True)
    (archive,) = (copy / "dist").glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        packed.extractall(target, filter="data")
    (folder,) = target.iterdir()
    return folder


@pytest.fixture(scope="module")
def metadata(unpacked: Path) -> Message:
    """What PyPI shows."""
    return message_from_bytes((unpacked / "PKG-INFO").read_bytes())


@pytest.mark.slow
def test_source_distribution_is_the_repository(unpacked: Path) -> None:
    """Documentation, tests, examples, benchmarks, generators and CI come along, and nothing that git ignores."""
    added = {"PKG-INFO", "setup.cfg"}
    files = {path.relative_to(unpacked).as_posix() for path in unpacked.rglob("*") if path.is_file()}
    assert {name for name in files if ".egg-info/" not in name} - added == listed()


@pytest.mark.slow
def test_links_of_the_description_lead_somewhere(metadata: Message) -> None:
    """PyPI knows no relative links; absolute ones are of the release's tag and of files that exist."""
    text = metadata.get_payload(decode=True).decode()  # type: ignore[union-attr]
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    assert len(links) > 20
    source = next(
        url for name, url in (each.split(", ") for each in metadata.get_all("Project-URL", [])) if name == "Source"
    )
    for link in links:
        assert link.startswith(("https://", "#")), link
        if link.startswith(source):
            kind, tag, path = link.removeprefix(f"{source}/").partition("#")[0].split("/", 2)
            assert tag == f"v{metadata['Version']}"
            assert (kind == "raw") == path.endswith((".png", ".svg", ".webp"))
            assert (ROOT / path).is_file(), path


def test_version_stands_everywhere() -> None:
    """Citation and recipe name the version that is built."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    for name, pattern in PLACES.items():
        found = re.search(pattern, (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)
        assert found, name
        assert found[1] == version, name


@pytest.mark.slow
def test_extra_of_a_dependency_stays_a_name(metadata: Message) -> None:
    """Commands that are written down (`pip install flexfmu[control]`) go on working."""
    assert "control" in metadata.get_all("Provides-Extra", [])
    assert any(re.match(r"control\b(?!.*extra)", each) for each in metadata.get_all("Requires-Dist", []))


def test_recipe_has_the_dependencies_of_the_package() -> None:
    """The conda package gets the same libraries with the same bounds."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (
        (ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8").partition("\n  run:\n")[2].partition("\ntests:")[0]
    )
    found = {line.split("#")[0].strip(" -") for line in recipe.splitlines()}
    names = {"matplotlib": "matplotlib-base"}
    needed = {
        f"{names.get(name, name)} >={bound}"
        for name, _, bound in (each.partition(">=") for each in project["dependencies"])
    }
    assert needed == {each for each in found if ">=" in each and not each.startswith("python ")}
