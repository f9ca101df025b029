"""Runs an SSP file in another tool: importer.py TOOL FILE STEP INSTANTS SIGNALS; prints signals at instants as JSON.

INSTANTS is a JSON list of times [s], SIGNALS one of pairs: the element's name within the system, and the variable.
Exit status 77: the tool isn't installed.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

MISSING = 77

Signals = list[tuple[str, str]]


def libcosimpy(path: str, step: float, instants: list[float], signals: Signals) -> list[list[float]]:
    """libcosim; a step of zero takes the file's own."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    nanoseconds = round(step * 1e9)
    execution = CosimExecution.from_ssp_file(path, nanoseconds) if nanoseconds else CosimExecution.from_ssp_file(path)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    slaves = {element: execution.slave_index_from_instance_name(element) for element, _ in signals}
    references = {
        (element, each.name.decode()): each.reference
        for element, slave in slaves.items()
        for each in execution.slave_variables(slave)
    }
    values = []
    for instant in instants:
        assert execution.simulate_until(target_time=round(instant * 1e9)), "libcosim failed on the way"
        found: dict[tuple[str, str], float] = {}
        for element, slave in slaves.items():
            wanted = [each for each in signals if each[0] == element]
            numbers = [references[each] for each in wanted]
            found |= zip(wanted, observer.last_real_values(slave_index=slave, variable_references=numbers), strict=True)
        values.append([found[each] for each in signals])
    return values


def ecospy(path: str, step: float, instants: list[float], signals: Signals) -> list[list[float]]:
    """ecos; its own ``step_until`` makes a step too many where times round."""
    from ecospy import EcosSimulation

    values, made = [], 0
    with EcosSimulation(ssp_path=path, step_size=step) as simulation:
        simulation.init()
        for instant in instants:
            simulation.step(round(instant / step) - made)
            made = round(instant / step)
            values.append([float(simulation.get_real("::".join(each))) for each in signals])
    return values


def omsimulator(path: str, step: float, instants: list[float], signals: Signals) -> list[list[float]]:
    """OMSimulator 3; a step of zero takes the file's own."""
    from OMSimulator import SSP, CRef

    os.chdir(tempfile.mkdtemp())  # it writes its results where it is
    package = SSP(str(Path(path)))
    system = str(package.activeVariant.system.name)
    model = package.instantiate()
    model.setResultFile("")
    model.setStopTime(2.0 * instants[-1] + 1.0)  # the step before it would be shorter
    if step:
        model.setFixedStepSize(step)
    model.initialize()
    names = [CRef(system, *element.split("."), variable) for element, variable in signals]
    values = []
    for instant in instants:
        if instant > 0.0:
            model.stepUntil(instant * (1.0 - 1e-9))  # it adds up times, and steps until it is there
        values.append([float(model.getValue(each)) for each in names])
    model.terminate()
    return values


TOOLS = {"libcosimpy": libcosimpy, "ecospy": ecospy, "OMSimulator": omsimulator}


def main() -> None:
    """Run the tool."""
    tool, path, step, instants, signals = sys.argv[1:]
    path = str(Path(path).resolve())
    try:
        __import__(tool)
    except (ImportError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(MISSING)
    pairs = [(element, variable) for element, variable in json.loads(signals)]
    values = TOOLS[tool](path, float(step), json.loads(instants), pairs)
    print("\n" + json.dumps({"values": values}), flush=True)
    os._exit(0)  # some tools crash when they are torn down


if __name__ == "__main__":
    main()
