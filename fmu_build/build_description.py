"""How to build the binary again from the FMU's own sources: FMI 3.0's build description, which FMI 2.0 tools read too."""

from __future__ import annotations

from collections.abc import Iterable

from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.toolchain import COMMON_FLAGS

BUILD_DESCRIPTION = "sources/buildDescription.xml"
"""Where it is in the FMU."""

OPTIONS = ("-O2", *COMMON_FLAGS)
"""Options of a compiler of GCC's or Clang's kind for the same numbers as the binaries give; others need C99 alone."""


def build_description(model_identifier: str, source_files: Iterable[str]) -> str:
    """The text of sources/buildDescription.xml: one set of C files, to be linked with the mathematics library."""
    return render(
        "buildDescription.xml.j2",
        model_identifier=model_identifier,
        source_files=source_files,
        options=" ".join(OPTIONS),
    )
