"""FMU files: unpacked once per content, parsed, and checked for use as a slave.

The FMUs used last stay unpacked, parsed and loaded (`KEPT`); another one leaves the disk and the memory when no slave has it any more.

Vendor annotations of our own FMUs state what FMI 2.0 can't: sample times, breakpoints, structured names, and the
names of numbered choices.
"""

from __future__ import annotations

import atexit
import errno
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from math import inf, isfinite
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakValueDictionary, finalize
from xml.etree import ElementTree

import fmpy
from fmpy.model_description import Item, SimpleType, read_model_description

from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.cosim.engine.fmu.variables import flattened, structural_sizes
from flexfmu.fmu_build.archive import open_archive
from flexfmu.fmu_build.choices import ANNOTATION
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.fmi_clock import PERIODIC, FmiClock, read_clocks
from flexfmu.fmu_build.interface import FIRST_DERIVATIVES
from flexfmu.fmu_build.naming import NAMES
from flexfmu.fmu_build.temporary import temporary_folder

Result = TypeVar("Result")

INTERPOLATION_ORDER = 1
"""Highest input derivative of an FMU that states only canInterpolateInputs; FMI 2.0 has no attribute for the order."""

EXCHANGE_ORDER = 9
"""Highest input derivative that our integrator takes for an FMU for model exchange, as many as our own FMUs."""

SYSTEM = (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.EROFS, errno.EACCES, errno.EIO)
"""Errors of the system while an FMU is unpacked: no space, no file descriptors, no right to write."""

KEPT = 32
"""FMUs that stay unpacked, parsed and loaded without a slave: those used last. Each takes about 1 MB of memory and 5 mappings."""

NEEDLESS = ("sources/", "documentation/")
"""Folders of an FMU that stay packed."""


class _Content:
    """Folder of an unpacked FMU, deleted with the last reference to this object; and its model description."""

    description: Any

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(dir=_root()))
        finalize(self, _remove, self.folder, os.getpid()).atexit = False


def _remove(folder: Path, process: int) -> None:
    """Remove a folder that this process has made, not that of the process from which it was forked."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class UnpackedFmu:
    """An unpacked FMU, ready to be loaded; equal to any other with the same content and sizes.

    Attributes:
        path: the FMU file.
        content: what has been unpacked, on the disk as long as anything refers to it.
        description: model description as fmpy reads it; for FMI 3.0 with one scalar variable per array element.
        sizes: (structural parameter, value) for those set by start values.
    """

    path: Path = field(compare=False)
    content: _Content
    description: Any = field(compare=False)
    sizes: tuple[tuple[str, int], ...] = ()

    @property
    def folder(self) -> Path:
        """Folder of the unpacked FMU."""
        return self.content.folder

    @property
    def is_fmi3(self) -> bool:
        """Whether the FMU is of FMI 3.0."""
        return str(self.description.fmiVersion).startswith("3.")

    @property
    def interface(self) -> Any:
        """The description of co-simulation, or else of model exchange or scheduled execution, as fmpy reads it."""
        description = self.description
        return description.coSimulation or description.modelExchange or description.scheduledExecution

    @property
    def kind(self) -> str:
        """The interface type: CoSimulation, ModelExchange or ScheduledExecution."""
        return type(self.interface).__name__

    @property
    def is_exchange(self) -> bool:
        """Whether the FMU is for model exchange only."""
        return self.kind == "ModelExchange"

    @property
    def clocks(self) -> tuple[FmiClock, ...]:
        """The input and output clocks of an FMU of FMI 3.0."""
        found: tuple[FmiClock, ...] = ()
        return attempt(self.path, lambda: read_clocks(parsed(self.folder).getroot())) if self.is_fmi3 else found

    @property
    def gives_directional_derivatives(self) -> bool:
        """Whether an FMU for model exchange states that it provides directional derivatives."""
        # fmpy doesn't read the attribute of FMI 3.0
        stated = parsed(self.folder).getroot().find("ModelExchange")
        names = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
        return stated is not None and any(stated.get(name) in ("true", "1") for name in names)

    @property
    def library(self) -> Path:
        """Path of the binary for this platform; the file may be missing."""
        platform: str = fmpy.platform_tuple if self.is_fmi3 else fmpy.platform
        identifier = self.interface.modelIdentifier
        return Path(self.folder, "binaries", platform, f"{identifier}{fmpy.sharedLibraryExtension}")

    @property
    def sampling(self) -> tuple[float, float] | None:
        """Sample time and offset [s] of an exported block, or of an FMU for co-simulation with all inputs and outputs on one periodic
        clock; None for any other FMU.

        Raises:
            FmuFileError: the annotation is invalid.
        """
        own = self.annotation("Sampling", lambda at: (_number(at["sampleTime"]), _number(at["offset"])))
        if own is not None or len(self.clocks) != 1 or self.kind != "CoSimulation":
            return own
        clock = self.clocks[0]
        signals = (v for v in self.description.modelVariables if v.causality in ("input", "output"))
        if clock.variability not in PERIODIC or any(v.handle.clocks != (clock.reference,) for v in signals):
            return None
        return (clock.interval, clock.shift) if clock.interval else None

    def annotation(self, element: str, parse: Callable[[dict[str, str]], Result]) -> Result | None:
        """Return the parsed attributes of an annotation of our own FMUs; None if there is no such annotation.

        Raises:
            FmuFileError: the annotation is invalid.
        """
        root = attempt(self.path, lambda: parsed(self.folder))
        places = "VendorAnnotations/Tool[@name='flexfmu']", "Annotations/Annotation[@type='flexfmu']"
        found = next((each for place in places if (each := root.find(f"{place}//{element}")) is not None), None)
        if found is None:
            return None
        try:
            return parse(found.attrib)
        except (KeyError, ValueError) as error:
            raise FmuFileError(
                f"{self.path} is a broken FMU: its {element} are {found.attrib}; build it again"
            ) from error

    @property
    def breakpoints(self) -> tuple[float, ...] | None:
        """Breakpoints [s] of an exported trajectory, ascending; None for any other FMU.

        Raises:
            FmuFileError: the annotation is invalid.
        """
        return self.annotation("Breakpoints", lambda at: tuple(map(_number, at["times"].split())))

    @property
    def is_ours(self) -> bool:
        """Whether this package exported the FMU."""
        return str(self.description.generationTool).startswith("flexfmu ")

    @property
    def needs_regular_steps(self) -> bool:
        """Whether all communication steps of the FMU must have the same length."""
        return self.kind == "CoSimulation" and not self.interface.canHandleVariableCommunicationStepSize

    @property
    def only_once_per_process(self) -> bool:
        """Whether the FMU can be instantiated only once per process."""
        return bool(self.interface.canBeInstantiatedOnlyOncePerProcess)

    @property
    def tool_hint(self) -> str:
        """A hint for the error of an FMU that needs an execution tool; empty for any other FMU."""
        if not self.interface.needsExecutionTool:
            return ""
        tool = self.description.generationTool or "the tool that exported it"
        return f"; it needs {tool} on this machine, running or licensed (needsExecutionTool = true)"

    @property
    def highest_input_derivative(self) -> int:
        """Order of the highest input derivative that the FMU takes, or our integrator for an FMU for model exchange; 0 if it doesn't
        interpolate inputs, as FMUs of FMI 3.0 but ours.

        Raises:
            FmuFileError: ``maxOrder`` of our own FMUs' annotation isn't a whole number.
        """
        if self.is_exchange:
            return EXCHANGE_ORDER
        interpolates = bool(getattr(self.interface, "canInterpolateInputs", False))
        if not interpolates and not (self.is_fmi3 and self.is_ours):
            return 0
        stated = self.annotation("InputDerivatives", lambda at: int(at["maxOrder"]))
        return INTERPOLATION_ORDER * interpolates if stated is None else stated

    @property
    def fixed_step(self) -> float | None:
        """Step size [s] of an FMU that can't vary its communication step; None for any other FMU.

        It is the step size of the default experiment, or else the fixed internal step size; None if neither is stated.

        Raises:
            FmuFileError: the step size isn't positive and finite.
        """
        if not self.needs_regular_steps:
            return None
        experiment = self.description.defaultExperiment
        stated = (experiment.stepSize if experiment else None) or self.interface.fixedInternalStepSize
        if not stated:
            return None
        step = float(stated)
        if not 0.0 < step < inf:
            raise FmuFileError(f"{self.path} is a broken FMU: its step size is {step:g} s; it must be positive")
        return step


def open_fmu(path: Path) -> UnpackedFmu:
    """Return an FMI 2.0 or 3.0 FMU for co-simulation or model exchange, unpacked unless this process still has it.

    Raises:
        FmuFileError: the FMU is missing, broken, of another kind, or has no binary for this platform.
    """
    try:
        # sizes and names first, for each file: nothing of an archive is believed before
        open_archive(path).close()
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except ArchiveError as error:
        raise FmuFileError(str(error)) from None
    except OSError as error:
        raise FmuFileError(f"can't read the FMU {path}: {error.strerror}; check the path") from error
    content = _unpack(digest, path)
    fmu = UnpackedFmu(path, content, content.description)
    _check(fmu)
    return fmu


def resized(fmu: UnpackedFmu, parameters: Mapping[str, Any]) -> UnpackedFmu:
    """Return the FMU with array sizes as the structural parameters among these start values state.

    Raises:
        InputError: the value of a structural parameter doesn't fit its type or range.
    """
    sizes = structural_sizes(fmu.description, parameters)
    if not sizes:
        return fmu
    description = attempt(fmu.path, lambda: read_model_description(str(fmu.folder), validate=False))
    return replace(fmu, description=flattened(description, fmu.folder, sizes), sizes=tuple(sizes.items()))


@cache
def _root() -> Path:
    """Return the folder of all unpacked FMUs of this process, deleted at its end."""
    folder = temporary_folder("fmus")
    atexit.register(folder.cleanup)
    return Path(folder.name)


# a forked process unpacks into a folder of its own
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_root.cache_clear)

_unpacked: WeakValueDictionary[str, _Content] = WeakValueDictionary()
"""SHA-256 of the content → what has been unpacked, so that each FMU is unpacked and parsed once."""

_used: dict[str, _Content] = {}
"""Those used last, the last one at the end."""


def _unpack(digest: str, path: Path) -> _Content:
    """Return the content of the FMU with that SHA-256; unpack and parse it unless it is there.

    Raises:
        FmuFileError: the FMU is broken.
    """
    content = _unpacked.get(digest)
    if content is None or not content.folder.is_dir():
        try:
            content = _Content()
        except OSError as error:
            raise _cannot_unpack(path, error) from error
        folder = content.folder
        # without what no run needs, most of the files
        attempt(path, lambda: fmpy.extract(str(path), str(folder), lambda name: not name.startswith(NEEDLESS)))
        description = attempt(path, lambda: read_model_description(str(folder), validate=False))
        # value references of 32 bits without sign, as the functions of FMI take them
        for variable in description.modelVariables:
            if not 0 <= int(variable.valueReference) < 1 << 32:
                raise FmuFileError(
                    f"{path} is a broken FMU: the value reference of {variable.name[:80]} is {variable.valueReference}; it must be "
                    "0 to 4294967295"
                )
        # annotations of our own FMUs
        fmu = UnpackedFmu(path, content, description)
        if fmu.is_ours:
            # structured names instead of flat ones, as in scenes and connections
            structured: Mapping[str, str] = fmu.annotation(NAMES, dict) or {}
            numbered = fmu.annotation(ANNOTATION, _numbered) or {}
            for variable in description.modelVariables:
                variable.name = structured.get(variable.name, variable.name)
                # names of numbered choices, declared like the items of an enumeration
                if variable.name in numbered:
                    items = [Item(name, str(value)) for name, value in numbered[variable.name].items()]
                    variable.declaredType = SimpleType(variable.name, type=variable.type, items=items)
        # FMI 3.0: one scalar variable per array element
        if fmu.is_fmi3:
            # input derivatives of our own FMUs, which aren't signals
            if fmu.is_ours:
                description.modelVariables = [
                    each for each in description.modelVariables if each.valueReference < FIRST_DERIVATIVES
                ]
            description = attempt(path, lambda: flattened(description, folder, {}))
        content.description = description
        _unpacked[digest] = content
    _used.pop(digest, None)
    _used[digest] = content
    for old in [*_used][:-KEPT]:
        _used.pop(old, None)
    return content


def attempt(path: Path, action: Callable[[], Any]) -> Any:
    """Return the result of an action with fmpy; any exception becomes an `FmuFileError`."""
    try:
        return action()
    except FmuFileError:
        raise
    except Exception as error:
        # full disks and the like aren't the FMU's fault
        if isinstance(error, OSError) and error.errno in SYSTEM:
            raise _cannot_unpack(path, error) from error
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FmuFileError(f"{path} is a broken FMU: {reason}; `flexfmu validate` tells more") from error


def _cannot_unpack(path: Path, error: OSError) -> FmuFileError:
    folder, files = tempfile.tempdir or "a temporary folder", error.errno in (errno.EMFILE, errno.ENFILE)
    remedy = "close files or raise `ulimit -n`" if files else "make room there, or set TMPDIR to another folder"
    return FmuFileError(f"can't unpack {path} into {folder}: {error.strerror}; {remedy}")


def _check(fmu: UnpackedFmu) -> None:
    """Check FMI version, kind and platform.

    Raises:
        FmuFileError: this program or platform can't run the FMU.
    """
    path, description = fmu.path, fmu.description
    if not description.fmiVersion.startswith(("2.", "3.")):
        raise FmuFileError(
            f"{path} is an FMU of FMI {description.fmiVersion}; this program runs FMI 2.0 and 3.0: export it again"
        )
    if fmu.interface is None:
        raise FmuFileError(f"{path} has no interface type that this program runs; export it for co-simulation")
    # clocks tick in event mode
    if fmu.clocks and fmu.kind == "CoSimulation" and not fmu.interface.hasEventMode:
        raise FmuFileError(
            f"{path} has clocks but no event mode (hasEventMode), in which they tick; export it with event mode"
        )
    # a binary for this platform
    if not fmu.library.is_file():
        platform = fmu.library.parent.name
        platforms = sorted(each.name for each in (fmu.folder / "binaries").glob("*") if each.is_dir())
        found = ", ".join(platforms) or "none"
        raise FmuFileError(f"{path} has no binary for {platform} (it has: {found}); build it for this platform")


@lru_cache(maxsize=KEPT)
def parsed(folder: Path) -> ElementTree.ElementTree[Any]:
    """The model description of an unpacked FMU, as XML."""
    return ElementTree.parse(folder / "modelDescription.xml")


def _number(text: str) -> float:
    """Return a finite number; raise ValueError for any other text."""
    value = float(text)
    if not isfinite(value):
        raise ValueError(text)
    return value


def _numbered(attributes: Mapping[str, str]) -> dict[str, dict[str, int]]:
    """Return the named values of Integer parameters (parameter → name → value), given as ``static=1 undeformed=2``."""
    pairs = {parameter: (item.partition("=") for item in text.split()) for parameter, text in attributes.items()}
    return {parameter: {name: int(number) for name, _, number in items} for parameter, items in pairs.items()}
