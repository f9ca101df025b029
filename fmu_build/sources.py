"""All that determines an FMU's behaviour, as text: C sources, model description, documentation, and their hash."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import TYPE_CHECKING, Literal

from flexfmu.fmu_build.build_description import BUILD_DESCRIPTION, build_description
from flexfmu.fmu_build.codegen import DESCRIPTION_FILE, generate_description, generate_functions, identifier
from flexfmu.fmu_build.description import Description, description_xml, plant_description
from flexfmu.fmu_build.documentation import documentation, plant_picture
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.hashing import content_hash
from flexfmu.fmu_build.icon import ICON_FILE, png
from flexfmu.fmu_build.naming import Naming, named_model

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel


Kind = Literal["plant", "block", "trajectory"]
"""What an FMU contains; the same FMI layer serves all of them."""

_COMMON = ("backend.", "clock.", "elementary", "fmi2", "memory.", "model.", "old_glibc.", "private.", "refusal.")
"""How the names of the runtime's files begin that every kind needs."""

_OWN = {"block": ("block", "inputs."), "trajectory": ("trajectory",)}
"""How the names of further files begin that these kinds need; the plant needs all but the files named after the others."""


@dataclass(frozen=True)
class Sources:
    """The text of an FMU before anything is compiled.

    Attributes:
        model_identifier: name of the shared library.
        guid: hash of the content, in the usual spelling with braces.
        description: modelDescription.xml.
        generated: C files of the model, name → text.
        runtime: C files and headers of the runtime, name → text.
        documentation: path below the FMU's root → text.
        icon: small picture, a PNG file; may be empty.
    """

    model_identifier: str
    guid: str
    description: str
    generated: dict[str, str]
    runtime: dict[str, str]
    documentation: dict[str, str]
    icon: bytes = b""

    @property
    def generated_bytes(self) -> int:
        """Size of the generated C."""
        return sum(len(text.encode()) for text in self.generated.values())

    def archive_files(self) -> dict[str, bytes]:
        """Path below the FMU's root → content, all but the binaries."""
        code = {f"sources/{name}": text for name, text in (self.generated | self.runtime).items()}
        built = {BUILD_DESCRIPTION: build_description(self.model_identifier, c_files((*self.generated, *self.runtime)))}
        texts = {"modelDescription.xml": self.description} | code | built | self.documentation
        return {path: text.encode() for path, text in texts.items()} | ({ICON_FILE: self.icon} if self.icon else {})


def generate_sources(
    model: SymbolicModel, experiment: DefaultExperiment, naming: Naming = "structured", enumerations: bool = False
) -> Sources:
    """Everything of the FMU that is text. The GUID is the hash of all of it, taken with a blank GUID.

    Raises:
        ModelError: the model contradicts its contract.
    """
    functions, facts = generate_functions(model)
    named = named_model(model, naming)

    def code(guid: str) -> dict[str, str]:
        return functions | {DESCRIPTION_FILE: generate_description(named, facts, guid, experiment.tolerance)}

    description = replace(plant_description(model).named(naming), enumerations=enumerations)
    pages = documentation(named, description, experiment)
    return assemble_sources("plant", description, experiment, code, pages, png(plant_picture(model)))


def assemble_sources(
    kind: Kind,
    description: Description,
    experiment: DefaultExperiment,
    code: Callable[[str], dict[str, str]],
    pages: dict[str, str],
    icon: bytes,
) -> Sources:
    """All parts of an FMU together.

    Args:
        kind: which runtime it needs.
        description: what the model description says.
        experiment: default experiment.
        code: the generated C files for a GUID, name → text.
        pages: documentation, path below the FMU's root → text.
        icon: small picture, a PNG file.
    """
    runtime = runtime_sources(kind)
    blank = code("")
    names = c_files((*blank, *runtime))
    blank_text = description_xml(description, "", experiment, names)
    guid = _guid((blank_text, *_flatten(blank), *_flatten(runtime)))
    text = description_xml(description, guid, experiment, names)
    return Sources(identifier(description.name), guid, text, code(guid), runtime, pages, icon)


def runtime_sources(kind: Kind = "plant") -> dict[str, str]:
    """C files and headers of the runtime for an FMU of that kind, name → text."""
    folder = files("flexfmu.fmu_build") / "c-runtime"
    entries = sorted((entry for entry in folder.iterdir() if _belongs(entry.name, kind)), key=lambda e: e.name)
    return {entry.name: entry.read_text(encoding="utf-8") for entry in entries}


def elementary_sources() -> dict[str, str]:
    """C files and headers of sin, exp and so on alone, which generated functions call."""
    return {name: text for name, text in runtime_sources().items() if name.startswith("elementary")}


def _belongs(name: str, kind: Kind) -> bool:
    """Whether a file is a part of the runtime for that kind; its name tells."""
    if not name.endswith((".c", ".h")):
        return False
    if kind == "plant":
        return not name.startswith(tuple(_OWN))
    return name.startswith((*_COMMON, *_OWN[kind]))


def c_files(names: Iterable[str]) -> tuple[str, ...]:
    """The names that a compiler is given, sorted: headers left out."""
    return tuple(sorted(name for name in names if name.endswith(".c")))


def _flatten(texts: dict[str, str]) -> tuple[str, ...]:
    return tuple(part for name in sorted(texts) for part in (name, texts[name]))


def _guid(parts: Iterable[str]) -> str:
    """Hash of ``parts`` in the spelling {8-4-4-4-12}."""
    text = content_hash(part.encode() for part in parts)
    return "{" + "-".join((text[:8], text[8:12], text[12:16], text[16:20], text[20:32])) + "}"
