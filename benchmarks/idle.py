"""Plants without equations, as an FMU and in Python: a run with one of them costs what master, trajectory and recording cost. Used by
`speed_measurements.py`; not a script of its own."""

from __future__ import annotations

import zipfile
from pathlib import Path

from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.slave import Call, Indices, RealArray
from flexfmu.fmu_build.archive import pack
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.sources import Sources
from flexfmu.fmu_build.toolchain import find_compiler, native_platform

SOURCE = "idle_fmu.c"


def idle_fmu(like: Path, folder: Path) -> Path:
    """An FMU with the description of another one and a binary whose functions do nothing."""
    with zipfile.ZipFile(like) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    texts = {SOURCE: Path(__file__).with_name(SOURCE).read_text(encoding="utf-8")}
    library = compile_library(Sources("idle", "", "", {}, texts, {}), find_compiler(native_platform()))
    binaries = [name for name in content if name.startswith("binaries/")]
    path = folder / "idle.fmu"
    path.write_bytes(pack(content | dict.fromkeys(binaries, library)))
    return path


class IdlePlant:
    """A slave in Python with the variables of another one."""

    def __init__(self, like: FmuSlave) -> None:
        self.name, self.variables, self.feedthrough = like.name, like.variables, like.feedthrough
        self.max_input_order, self.max_output_order = like.max_input_order, like.max_output_order

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None: ...
    def step(self, time: float, step: float) -> None: ...
    def set(self, indices: Indices, values: RealArray) -> None: ...
    def get(self, indices: Indices, values: RealArray) -> None: ...
    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None: ...
    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None: ...

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        return do_nothing

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        values[:] = 0.0
        return do_nothing

    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        return do_nothing

    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        derivatives[:] = 0.0
        return do_nothing


def do_nothing() -> None:
    """A call that transfers nothing."""
