"""Runs an SSP file in another tool: importer.py TOOL FILE STEP INSTANTS SIGNAL; prints the robot's signal at instants (a
JSON list) as JSON.

Exit status 77: the tool isn't installed.
"""

from __future__ import annotations

import json
import sys

MISSING = 77


def libcosimpy(path: str, step: float, instants: list[float], signal: str) -> list[float]:
    """libcosim; a step of zero takes the file's own."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    nanoseconds = round(step * 1e9)
    execution = CosimExecution.from_ssp_file(path, nanoseconds) if nanoseconds else CosimExecution.from_ssp_file(path)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    plant = execution.slave_index_from_instance_name("plant")
    references = {each.name.decode(): each.reference for each in execution.slave_variables(plant)}
    values = []
    for instant in instants:
        assert execution.simulate_until(target_time=round(instant * 1e9)), "libcosim failed on the way"
        values += observer.last_real_values(slave_index=plant, variable_references=[references[signal]])
    return values


def ecospy(path: str, step: float, instants: list[float], signal: str) -> list[float]:
    """ecos; its own ``step_until`` makes a step too many where times round."""
    from ecospy import EcosSimulation

    values, made = [], 0
    with EcosSimulation(ssp_path=path, step_size=step) as simulation:
        simulation.init()
        for instant in instants:
            simulation.step(round(instant / step) - made)
            made = round(instant / step)
            values.append(float(simulation.get_real(f"plant::{signal}")))
    return values


def omsimulator(path: str, step: float, instants: list[float], signal: str) -> list[float]:
    """OMSimulator."""
    from OMSimulator import OMSimulator

    oms = OMSimulator()
    name, status = oms.importFile(path)
    assert status == 0, "OMSimulator can't import the file"
    oms.setFixedStepSize(name, step)
    oms.setStopTime(name, instants[-1])
    for action in (oms.instantiate, oms.initialize):
        assert action(name) == 0, f"OMSimulator: {action.__name__} failed"
    values = []
    for instant in instants:
        assert oms.stepUntil(name, instant) == 0, "OMSimulator failed on the way"
        value, status = oms.getReal(f"{name}.{name}.plant.{signal}")
        assert status == 0, "OMSimulator has no such signal"
        values.append(float(value))
    return values


TOOLS = {"libcosimpy": libcosimpy, "ecospy": ecospy, "OMSimulator": omsimulator}


def main() -> None:
    """Run the tool."""
    tool, path, step, instants, signal = sys.argv[1:]
    try:
        __import__(tool)
    except (ImportError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(MISSING)
    print(json.dumps({"values": TOOLS[tool](path, float(step), json.loads(instants), signal)}))


if __name__ == "__main__":
    main()
