"""FMUs as other tools might make them, compiled on the spot."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from flexfmu.fmu_build.toolchain import fmi_header_folder

SOURCES = Path(__file__).parent / "cosim" / "engine" / "foreign-fmu"


def maker(folder: Path, name: str, description_file: str, own_platform: str = fmpy.platform) -> Callable[..., Path]:
    """Packs FMUs of one library, with changes of one description, also as for another platform."""
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    library = folder / f"{name}{fmpy.sharedLibraryExtension}"
    command = [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    files = [f"-I{fmi_header_folder()}", SOURCES / f"{name}.c", "-lm", "-o", library]
    subprocess.run([*command, *files], check=True, capture_output=True)
    description = (SOURCES / description_file).read_text()

    def make(*changes: tuple[str, str], platform: str = own_platform) -> Path:
        text = description
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = folder / f"{name}{len(list(folder.iterdir()))}.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text)
            archive.write(library, f"binaries/{platform}/{library.name}")
        return path

    return make
