"""All that determines an FMU's behaviour, as text: C sources, model description, documentation, and their hash."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from flexfmu.fmu_build.codegen import DESCRIPTION_FILE, generate_description, generate_functions, identifier
from flexfmu.fmu_build.description import model_description
from flexfmu.fmu_build.documentation import documentation
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.hashing import content_hash

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel


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
    """

    model_identifier: str
    guid: str
    description: str
    generated: dict[str, str]
    runtime: dict[str, str]
    documentation: dict[str, str]

    @property
    def generated_bytes(self) -> int:
        """Size of the generated C."""
        return sum(len(text.encode()) for text in self.generated.values())

    def archive_files(self) -> dict[str, bytes]:
        """Path below the FMU's root → content, all but the binaries."""
        code = {f"sources/{name}": text for name, text in (self.generated | self.runtime).items()}
        texts = {"modelDescription.xml": self.description} | code | self.documentation
        return {path: text.encode() for path, text in texts.items()}


def generate_sources(model: SymbolicModel, experiment: DefaultExperiment) -> Sources:
    """Everything of the FMU that is text. The GUID is the hash of all of it, taken with a blank GUID.

    Raises:
        ModelError: the model contradicts its contract.
    """
    functions, facts = generate_functions(model)
    runtime = runtime_sources()
    names = c_files((DESCRIPTION_FILE, *functions, *runtime))

    def with_guid(guid: str) -> tuple[str, dict[str, str]]:
        code = functions | {DESCRIPTION_FILE: generate_description(model, facts, guid, experiment.tolerance)}
        return model_description(model, guid, experiment, names), code

    blank_description, blank_code = with_guid("")
    guid = _guid((blank_description, *_flatten(blank_code), *_flatten(runtime)))
    description, code = with_guid(guid)
    return Sources(identifier(model.name), guid, description, code, runtime, documentation(model, experiment))


def runtime_sources() -> dict[str, str]:
    """C files and headers of the runtime, name → text."""
    folder = files("flexfmu.fmu_build") / "c-runtime"
    entries = sorted((entry for entry in folder.iterdir() if entry.name.endswith((".c", ".h"))), key=lambda e: e.name)
    return {entry.name: entry.read_text(encoding="utf-8") for entry in entries}


def c_files(names: Iterable[str]) -> tuple[str, ...]:
    """The names that a compiler is given, sorted: headers left out."""
    return tuple(sorted(name for name in names if name.endswith(".c")))


def _flatten(texts: dict[str, str]) -> tuple[str, ...]:
    return tuple(part for name in sorted(texts) for part in (name, texts[name]))


def _guid(parts: Iterable[str]) -> str:
    """Hash of ``parts`` in the spelling {8-4-4-4-12}."""
    text = content_hash(part.encode() for part in parts)
    return "{" + "-".join((text[:8], text[8:12], text[12:16], text[16:20], text[20:32])) + "}"
