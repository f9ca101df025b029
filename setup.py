"""What a release holds beyond what pyproject.toml can say.

A wheel has `src/flexfmu`, and inside it the packages that are folders at the top of the repository. An editable install puts `src`
on Python's path, where `flexfmu/__init__.py` finds the folders itself. If pyproject.toml mapped them (`package-dir`), setuptools
would install an import hook instead that Python asks only after its path: a folder called `flexfmu` in the working directory, such
as a clone, would be imported in place of the package.

A source distribution has every file that `.gitignore` doesn't exclude. The description on PyPI is README.md with absolute links.
"""

import os
import re
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

ROOT = Path(__file__).parent
FOLDERS = ("model", "fmu_build", "trajectories", "cosim", "benchmarks/hard_cases", "benchmarks/peers")


class BuildWithFolders(build_py):
    """Builds the folders and all packages in them as parts of `flexfmu`."""

    def finalize_options(self) -> None:
        super().finalize_options()
        for folder in FOLDERS:
            name = f"flexfmu.{folder.replace('/', '.')}"
            self.packages = [*self.packages, name, *(f"{name}.{package}" for package in find_packages(folder))]
            self.package_dir = {**self.package_dir, name: folder}


class CompleteSource(sdist):
    """Packs documentation, tests, examples, benchmarks and generators too."""

    def make_distribution(self) -> None:
        self.filelist.extend(every_file())
        self.filelist.remove_duplicates()
        super().make_distribution()


def every_file() -> Iterator[str]:
    """Paths of all files of the project, relative to its folder."""
    lines = (ROOT / ".gitignore").read_text(encoding="utf-8").split()
    ignored = (".git", "PKG-INFO", "setup.cfg", *(line.rstrip("/") for line in lines))

    def kept(names: list[str]) -> list[str]:
        return sorted(name for name in names if not any(fnmatch(name, pattern) for pattern in ignored))

    for folder, folders, files in os.walk(ROOT):
        folders[:] = kept(folders)
        yield from (os.path.relpath(Path(folder, file), ROOT) for file in kept(files))


def description() -> str:
    """README.md with links to, and pictures from, the repository at the release's tag."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    source, tag = project["urls"]["Source"], f"v{project['version']}"

    def absolute(match: re.Match[str]) -> str:
        return f"{match['picture']}[{match['text']}]({source}/{'raw' if match['picture'] else 'blob'}/{tag}/{match['path']})"

    relative = r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?![a-z]+:|#)(?P<path>[^)\s]+)\)"
    return re.sub(relative, absolute, (ROOT / "README.md").read_text(encoding="utf-8"))


setup(
    cmdclass={"build_py": BuildWithFolders, "sdist": CompleteSource},
    long_description=description(),
    long_description_content_type="text/markdown",
)
