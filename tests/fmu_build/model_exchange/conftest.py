"""Plants of scenes through plain fmpy, as instances for model exchange or for co-simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave
from numpy.typing import NDArray

from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.scene.file import load_scene

Array = NDArray[np.float64]
Kind = Literal["exchange", "stepping"]


class Instance:
    """An instance with its variables by name; ``kind`` is who integrates."""

    def __init__(self, path: Path, folder: Path, kind: Kind) -> None:
        self.description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.inputs = [v.name for v in self.description.modelVariables if v.causality == "input"]
        self.outputs = [unknown.variable.name for unknown in self.description.outputs]
        self.states = [unknown.variable.derivative.name for unknown in self.description.derivatives]
        self.parameters = [
            v.name for v in self.description.modelVariables if v.causality == "parameter" and v.type == "Real"
        ]
        self.fmu: Any = (FMU2Model if kind == "exchange" else FMU2Slave)(
            guid=self.description.guid,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            unzipDirectory=str(folder),
            instanceName="plant",
        )
        self.fmu.instantiate()
        self.kind = kind

    def initialize(self, tolerance: float | None = None) -> None:
        """Everything up to initialization mode."""
        self.fmu.setupExperiment(tolerance=tolerance, startTime=0.0)
        self.fmu.enterInitializationMode()

    def begin(self) -> None:
        """Everything up to the motion."""
        self.fmu.exitInitializationMode()
        if self.kind == "exchange":
            self.fmu.newDiscreteStates()
            self.fmu.enterContinuousTimeMode()

    def of(self, names: Sequence[str]) -> list[int]:
        """Their value references."""
        return [self.references[name] for name in names]

    def get(self, names: Sequence[str]) -> Array:
        return np.array(self.fmu.getReal(self.of(names)))

    def set(self, names: Sequence[str], values: Sequence[float] | Array) -> None:
        self.fmu.setReal(self.of(names), [float(value) for value in values])

    def set_rates(self, names: Sequence[str], values: Sequence[float] | Array) -> None:
        """First derivatives of inputs."""
        self.fmu.setRealInputDerivatives(self.of(names), [1] * len(names), [float(value) for value in values])

    def _read(self, function: Callable[[Any, int], Any]) -> Array:
        values = np.full(len(self.states), np.nan)
        function(values.ctypes.data_as(fmpy.fmi2.POINTER(fmpy.fmi2.fmi2Real)), values.size)
        return values

    @property
    def x(self) -> Array:
        """The continuous states."""
        return self._read(self.fmu.getContinuousStates)

    @x.setter
    def x(self, values: Array) -> None:
        copy = np.array(values, dtype=np.float64)
        self.fmu.setContinuousStates(copy.ctypes.data_as(fmpy.fmi2.POINTER(fmpy.fmi2.fmi2Real)), copy.size)

    @property
    def rates(self) -> Array:
        """Their time derivatives."""
        return self._read(self.fmu.getDerivatives)

    @property
    def nominals(self) -> Array:
        """Their usual sizes."""
        return self._read(self.fmu.getNominalsOfContinuousStates)

    def jacobian(self, unknowns: Sequence[str], knowns: Sequence[str]) -> Array:
        """Directional derivatives along each known variable, (unknowns, knowns)."""
        columns = [self.fmu.getDirectionalDerivative(self.of(unknowns), self.of([known]), [1.0]) for known in knowns]
        return np.array(columns).reshape(len(knowns), len(unknowns)).T


Instantiate = Callable[..., Instance]


@pytest.fixture(autouse=True)
def cache_folder(shared_cache: Path) -> Path:
    """These tests need no empty cache."""
    return shared_cache


@pytest.fixture(scope="module")
def plant_path(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[Path, Path]]:
    """Function from changes of the 6 kg scene to its FMU and where that is unpacked."""
    built: dict[str, tuple[Path, Path]] = {}

    def path(changes: Mapping[str, object]) -> tuple[Path, Path]:
        key = repr(sorted(changes.items()))
        if key not in built:
            folder = tmp_path_factory.mktemp("plant")
            scene = load_scene("barnard2012-6kg").replace(changes)
            fmu = build_scene(scene, output=folder / "plant.fmu").path
            built[key] = fmu, Path(fmpy.extract(str(fmu), str(folder / "unpacked")))
        return built[key]

    return path


@pytest.fixture
def instantiate(plant_path: Callable[..., tuple[Path, Path]]) -> Iterator[Instantiate]:
    """Function that makes an `Instance` of the 6 kg scene with changes."""
    instances: list[Instance] = []

    def make(changes: Mapping[str, object], kind: Kind = "exchange") -> Instance:
        instances.append(Instance(*plant_path(changes), kind))
        return instances[-1]

    yield make
    for instance in instances:
        instance.fmu.freeInstance()


def integrate(
    path: Path,
    names: Sequence[str],
    rows: Sequence[tuple[float, ...]],
    outputs: Sequence[str],
    interval: float,
    tolerance: float,
) -> Array:
    """Outputs after each interval, (times, outputs), by fmpy's CVODE, which restarts where the table of inputs names a time twice."""
    result = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        stop_time=rows[-1][0],
        output_interval=interval,
        relative_tolerance=tolerance,
        input=np.array(rows, dtype=[("time", float), *((name, float) for name in names)]),
        output=list(outputs),
        record_events=False,
    )
    assert np.allclose(result["time"], interval * np.arange(len(result)))
    return np.column_stack([result[name] for name in outputs])


@pytest.fixture(name="integrate")
def integrator() -> Callable[..., Array]:
    """Function `integrate`."""
    return integrate
