"""What a wheel contains: `src/flexfmu`, and inside it the packages that are folders at the top of the repository.

Everything else about the project is in pyproject.toml. An editable install puts `src` on Python's path, where
`flexfmu/__init__.py` finds the folders itself. If pyproject.toml mapped them (`package-dir`), setuptools would install an import
hook instead that Python asks only after its path: a folder called `flexfmu` in the working directory, such as a clone, would be
imported in place of the package.
"""

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

FOLDERS = ("model", "fmu_build", "trajectories", "cosim", "benchmarks/hard_cases")


class BuildWithFolders(build_py):
    """Builds the folders and all packages in them as parts of `flexfmu`."""

    def finalize_options(self) -> None:
        super().finalize_options()
        for folder in FOLDERS:
            name = f"flexfmu.{folder.replace('/', '.')}"
            self.packages = [*self.packages, name, *(f"{name}.{package}" for package in find_packages(folder))]
            self.package_dir = {**self.package_dir, name: folder}


setup(cmdclass={"build_py": BuildWithFolders})
