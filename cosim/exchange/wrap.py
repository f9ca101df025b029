"""FMUs for model exchange of FMI 2.0 as FMUs for co-simulation: the original library with our integrator around it.

Variables, value references and everything else of the FMU stay as they are.
"""

from __future__ import annotations

import os
import zipfile
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.exchange import TOLERANCE
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, open_fmu, parsed
from flexfmu.cosim.engine.shared_library import library_texts
from flexfmu.fmu_build.archive import pack, read_member, write_atomically
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.sources import Sources, c_files
from flexfmu.fmu_build.toolchain import FMI_HEADERS, find_compiler, fmi_header_folder, native_platform

KEPT = ("needsExecutionTool", "canBeInstantiatedOnlyOncePerProcess", "canNotUseMemoryManagementFunctions")
"""Attributes of model exchange that hold for co-simulation, too."""


def wrap_fmu(path: Path, target: Path) -> None:
    """Write an FMU for co-simulation on this machine's platform with the FMU for model exchange in it.

    Args:
        path: an FMU for model exchange, with a library for this machine.
        target: the FMU to be written.

    Raises:
        FmuFileError: the FMU is missing or broken.
        InputError: it isn't one of FMI 2.0 for model exchange only, or the target is the FMU itself.
        BuildError: the library can't be compiled, for example without a C compiler.
        ArchiveError: the target can't be written.
    """
    fmu = open_fmu(path)
    if not fmu.is_exchange or fmu.is_fmi3:
        kind = f"FMI {fmu.description.fmiVersion} for {'model exchange' if fmu.is_exchange else 'co-simulation'}"
        raise InputError(f"{path} is an FMU of {kind}; only one of FMI 2.0 for model exchange alone is wrapped")
    if native_platform().suffix == ".dll":
        raise InputError(f"{path} can't be wrapped on Windows; wrap it on Linux or macOS, for these")
    if target.exists() and os.path.samefile(path, target):
        raise InputError(f"{target} is the FMU itself; name another file with --output")
    # all files but sources, whose library has another name, and libraries for other machines
    identifier, platform = fmu.interface.modelIdentifier, native_platform()
    folder = f"binaries/{platform.name}/"
    with zipfile.ZipFile(path) as archive:
        members = [each for each in archive.infolist() if not each.is_dir()]
        content = {
            each.filename: read_member(archive, each)
            for each in members
            if not each.filename.startswith(("sources/", "binaries/")) or each.filename.startswith(folder)
        }
    content["modelDescription.xml"] = _description(fmu)
    # the library beside that of the FMU
    texts = library_texts("exchange")
    joined = c_files(texts)
    texts["wrap.c"] = files(__package__).joinpath("c-wrap/wrap.c").read_text(encoding="utf-8")
    texts |= {name: (fmi_header_folder() / name).read_text(encoding="utf-8") for name in FMI_HEADERS["2"][:2]}
    # the functions of FMI alone are exported
    texts["exchange.h"] = texts["exchange.h"].replace("FLEX_EXPORTED ", "")
    texts["wrap_model.h"] = _table(fmu, f"{identifier}{platform.suffix}")
    compiler = find_compiler(platform)
    if platform.suffix == ".so":
        links = (*compiler.platform.link_flags, "-ldl")
        compiler = replace(compiler, platform=replace(compiler.platform, link_flags=links))
    sources = Sources(f"{identifier}_cs", "", "", {}, texts, {}, joined=joined)
    content[f"{folder}{identifier}_cs{platform.suffix}"] = compile_library(sources, compiler)
    write_atomically(target, pack(content))


def _description(fmu: UnpackedFmu) -> bytes:
    """The model description for co-simulation."""
    tree = ElementTree.parse(fmu.folder / "modelDescription.xml")
    root = tree.getroot()
    exchange = root.find("ModelExchange")
    assert exchange is not None
    stated = {name: value for name in KEPT if (value := exchange.get(name)) is not None}
    attributes = {
        "modelIdentifier": f"{fmu.interface.modelIdentifier}_cs",
        "canHandleVariableCommunicationStepSize": "true",
    }
    element = ElementTree.Element("CoSimulation", attributes | stated)
    element.tail = exchange.tail
    root[list(root).index(exchange)] = element
    root.attrib.pop("numberOfEventIndicators", None)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _table(fmu: UnpackedFmu, library: str) -> str:
    """What ``wrap.c`` has to know of the FMU, as a header."""
    unknowns = [each.variable for each in fmu.description.derivatives or ()]
    known = [each.derivative.valueReference for each in unknowns if each.derivative is not None]
    experiment = fmu.description.defaultExperiment
    completed = parsed(fmu.folder).getroot().find("ModelExchange[@completedIntegratorStepNotNeeded='true']") is None
    numbers = {
        "N": len(unknowns),
        "M": int(fmu.description.numberOfEventIndicators or 0),
        "NEEDS_COMPLETED": int(completed),
        "HAS_DIRECTIONAL": int(fmu.gives_directional_derivatives and len(known) == len(unknowns) > 0),
    }
    lists = {"unknown": [each.valueReference for each in unknowns], "known": known}
    return "\n".join(
        (
            f'#define INNER "{library}"',
            f"#define TOLERANCE {float(getattr(experiment, 'tolerance', None) or TOLERANCE)!r}",
            f"enum {{{', '.join(f'{name} = {value}' for name, value in numbers.items())}}};",
            *(
                f"static const unsigned {name}[] = {{{', '.join(map(str, (*each, 0)))}}};"
                for name, each in lists.items()
            ),
            "",
        )
    )
