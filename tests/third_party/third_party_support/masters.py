"""Other people's masters run exported FMUs: python masters.py NAME SYSTEM STEP STOP; prints a JSON list of rows.

Each is a small program of its own, since these libraries write to standard output, or may end their process.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any

Rows = list[list[float]]
System = dict[str, Any]
"""``fmus``: name of a slave → its file; ``connections``: pairs of full names; ``signals``: full names of outputs to record."""


def libcosim(system: System, step: float, count: int) -> Rows:
    """The Open Simulation Platform's master, fixed steps."""
    from fmpy import read_model_description
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(round(step * 1e9))
    indices, references = {}, {}
    for name, path in system["fmus"].items():
        indices[name] = execution.add_local_slave(CosimLocalSlave(path, name))
        variables = read_model_description(path).modelVariables
        references[name] = {variable.name: variable.valueReference for variable in variables}
    for source, target in system["connections"]:
        (giver, output), (taker, given) = source.split(".", 1), target.split(".", 1)
        ends = indices[giver], references[giver][output], indices[taker], references[taker][given]
        assert execution.connect_real_variables(*ends) == 0
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    signals = [each.split(".", 1) for each in system["signals"]]
    wanted = {name: [references[name][variable] for owner, variable in signals if owner == name] for name in indices}
    rows = []
    for n in range(count):
        assert execution.step(1)
        values = {name: iter(observer.last_real_values(indices[name], each)) for name, each in wanted.items() if each}
        rows.append([(n + 1) * step, *(next(values[owner]) for owner, _ in signals)])
    return rows


def ecos(system: System, step: float, count: int) -> Rows:
    """NTNU's master, fixed steps."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    for name, path in system["fmus"].items():
        structure.add_model(name, path)
    for ends in system["connections"]:
        structure.make_real_connection(*(end.replace(".", "::", 1) for end in ends))
    simulation = EcosSimulation(structure=structure, step_size=step)
    simulation.init()
    rows = []
    for n in range(count):
        simulation.step(1)
        rows.append([(n + 1) * step, *(simulation.get_real(name.replace(".", "::", 1)) for name in system["signals"])])
    return rows


def omsimulator(system: System, step: float, count: int) -> Rows:
    """OpenModelica's master, version 3, fixed steps."""
    from OMSimulator import SSP, CRef

    package = SSP()
    for name, path in system["fmus"].items():
        package.addResource(path, new_name=f"resources/{name}.fmu")
        package.addComponent(CRef("default", name), f"resources/{name}.fmu")
    for ends in system["connections"]:
        package.addConnection(*(CRef("default", *end.split(".", 1)) for end in ends))
    # under the name that it looks for by default; FMUs are told the tolerance when they are instantiated
    package.newSolver({"name": "oms_ma_default", "method": "oms_ma", "fixedStepSize": step, "relativeTolerance": 1e-6})
    model = package.instantiate()
    model.setResultFile("")
    model.setStopTime(2.0 * count * step)
    model.initialize()
    names = [CRef("default", *each.split(".", 1)) for each in system["signals"]]
    rows = []
    for n in range(1, count + 1):
        model.stepUntil((n - 1e-6) * step)  # it adds up times
        rows.append([n * step, *(model.getValue(each) for each in names)])
    return rows


MASTERS: dict[str, Callable[[System, float, int], Rows]] = {
    "libcosim": libcosim,
    "ecos": ecos,
    "OMSimulator": omsimulator,
}


def main() -> None:
    """Run the master that the command line names."""
    name, file, step, stop = sys.argv[1:]
    with open(file, encoding="utf-8") as text:
        system = json.load(text)
    rows = MASTERS[name](system, float(step), round(float(stop) / float(step)))
    print("\nrows: " + json.dumps(rows), flush=True)


if __name__ == "__main__":
    main()
