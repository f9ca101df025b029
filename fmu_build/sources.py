"""The text files of an FMU or of another library in C: those of the runtime, and of what is generated for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Literal

from flexfmu.fmu_build.toolchain import COMMON_FLAGS, FMI_HEADERS, SOLVER_FOLDERS, FmiVersion, fmi_header_folder
from flexfmu.model.symbolic import SharedLibrary

ICON_FILES: Mapping[FmiVersion, str] = {"2": "model.png", "3": "terminalsAndIcons/icon.png"}
"""Path of the icon in the FMU (FMI 2.0.4, section 2.3; FMI 3.0, section 2.5)."""

FmuKind = Literal["plant", "block", "trajectory"]
"""Kind of an FMU; all kinds share the FMI layer of the runtime."""

RuntimeKind = FmuKind | Literal["batch", "elementary", "processor"]
"""What the C runtime is compiled for."""

BUILD_DESCRIPTION = "sources/buildDescription.xml"
"""Path of FMI 3.0's build description, which tools for FMI 2.0 read too."""

OPTIONS = ("-O2", *COMMON_FLAGS)
"""Options for GCC and Clang that reproduce the numbers of the binaries; other compilers only need C99."""

_FOLDERS: Mapping[str, tuple[str, ...]] = {
    "plant": (*SOLVER_FOLDERS, "plant"),
    "block": ("base", "inputs", "math", "block"),
    "trajectory": ("base", "math", "trajectory"),
    "batch": (*SOLVER_FOLDERS, "batch"),
    "elementary": ("math", "lanes"),
    "processor": ("lanes",),
}
"""What is compiled → folders of ``c-runtime`` that it needs; their files lie side by side in an FMU."""

_FMI_FOLDERS: Mapping[tuple[str, FmiVersion], tuple[str, ...]] = {
    ("plant", "2"): ("fmi", "exchange", "fmi2", "fmi2-exchange"),
    ("block", "2"): ("fmi", "no-exchange", "fmi2"),
    ("trajectory", "2"): ("fmi", "no-exchange", "fmi2"),
    ("plant", "3"): ("fmi", "exchange", "fmi3"),
    ("block", "3"): ("fmi", "exchange", "no-exchange", "fmi3"),
    ("trajectory", "3"): ("fmi", "exchange", "no-exchange", "fmi3"),
}
"""Kind of FMU and version of FMI → further folders."""

_SHARED = ("fmi", "exchange")
"""Folders that both versions have, written in the words of FMI 2.0."""

_FMI3_TEXTS = (
    ("fmi2Component", "fmi3Instance"),
    ("fmi2GetRealOutputDerivatives", "fmi3GetOutputDerivatives"),
    *((f"fmi2{verb}Real", f"fmi3{verb}Float64") for verb in ("Get", "Set", "")),
    *((f"fmi2{verb}Integer", f"fmi3{verb}Int32") for verb in ("Get", "Set", "")),
    ("fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"),
    ("FMUstate", "FMUState"),
    ("DeSerialize", "Deserialize"),
    ("the GUID", "the instantiation token"),
    ('"step complete"', '"step mode"'),
    ("FMI2", "FMI3"),
    ("fmi2", "fmi3"),
)
"""What makes code in the words of FMI 3.0 of that in the words of FMI 2.0."""


@dataclass(frozen=True)
class Sources:
    """The content of an FMU before compilation.

    Attributes:
        model_identifier: name of the shared library.
        guid: hash of the content, as {8-4-4-4-12} hexadecimal digits.
        description: text of modelDescription.xml.
        generated: C files of the model, name → text.
        runtime: C files and headers of the runtime, name → text.
        documentation: path below the FMU's root → text.
        icon: PNG file; may be empty.
        icon_file: path of the icon below the FMU's root.
        libraries: shared libraries that the FMU's own one needs beside it, name → library.
        joined: C files of ``runtime`` that may be compiled as one, since none has a name that another defines for itself.
    """

    model_identifier: str
    guid: str
    description: str
    generated: dict[str, str]
    runtime: dict[str, str]
    documentation: dict[str, str]
    icon: bytes = b""
    icon_file: str = ICON_FILES["2"]
    libraries: Mapping[str, SharedLibrary] = field(default_factory=dict)
    joined: tuple[str, ...] = ()

    def archive_files(self) -> dict[str, bytes]:
        """Path below the FMU's root → content, without binaries."""
        from flexfmu.fmu_build.templating import render  # loads Jinja, which only a build needs

        code = {f"sources/{name}": text for name, text in (self.generated | self.runtime).items()}
        # build description for tools that compile the sources
        rebuild = render(
            "buildDescription.xml.j2",
            model_identifier=self.model_identifier,
            source_files=c_files((*self.generated, *self.runtime)),
            options=" ".join(OPTIONS),
        )
        texts = {"modelDescription.xml": self.description, BUILD_DESCRIPTION: rebuild} | code | self.documentation
        return {path: text.encode() for path, text in texts.items()} | (
            {self.icon_file: self.icon} if self.icon else {}
        )


def runtime_sources(kind: RuntimeKind = "plant", fmi: FmiVersion = "2") -> dict[str, str]:
    """C files and headers of the runtime, name → text, with the standard's headers where it has the FMI layer.

    Args:
        kind: kind of FMU; ``batch``: the solver of variants in lockstep, without FMI; ``elementary``: the functions (sin, exp, ...),
            scalar and on lanes, that generated code calls; ``processor``: tells how many lanes this processor has.
        fmi: version of FMI.
    """
    layer = _FMI_FOLDERS.get((kind, fmi), ())
    headers = [fmi_header_folder() / name for name in FMI_HEADERS[fmi]] if layer else []
    texts = {entry.name: entry.read_text(encoding="utf-8") for entry in headers}
    for folder in (*_FOLDERS[kind], *layer):
        for name, text in folder_texts(folder).items():
            for old, new in _FMI3_TEXTS if fmi == "3" and folder in _SHARED else ():
                text = text.replace(old, new)
            texts[name] = text
    return dict(sorted(texts.items()))


def folder_texts(folder: str) -> dict[str, str]:
    """C files and headers of a folder of the runtime, name → text."""
    entries = (files("flexfmu.fmu_build") / "c-runtime" / folder).iterdir()
    return {each.name: each.read_text(encoding="utf-8") for each in entries if each.name.endswith((".c", ".h"))}


def c_files(names: Iterable[str]) -> tuple[str, ...]:
    """The C files among ``names``, sorted."""
    return tuple(sorted(name for name in names if name.endswith(".c")))
