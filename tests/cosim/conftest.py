"""An FMU from elsewhere, compiled on the spot."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from importlib.resources import as_file, files
from pathlib import Path

import fmpy
import pytest

FOREIGN = Path(__file__).parent / "foreign-fmu"


@pytest.fixture(scope="session")
def foreign_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain FMI 2.0 co-simulation FMU that knows nothing of ours."""
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    folder = tmp_path_factory.mktemp("foreign")
    library = folder / f"decay{fmpy.sharedLibraryExtension}"
    with as_file(files("flexfmu.fmu_build") / "c-runtime") as headers:
        command = [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{headers}"]
        subprocess.run([*command, str(FOREIGN / "decay.c"), "-lm", "-o", str(library)], check=True, capture_output=True)
    return pack(folder / "decay.fmu", (FOREIGN / "modelDescription.xml").read_text(), library)


def pack(path: Path, description: str, library: Path | None, platform: str = fmpy.platform) -> Path:
    """Zip an FMU."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        if library is not None:
            archive.write(library, f"binaries/{platform}/decay{fmpy.sharedLibraryExtension}")
    return path
