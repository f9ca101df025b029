"""Runs an SSP file in another tool: importer.py TOOL FILE STEP INSTANT SIGNAL; prints the robot's signal as JSON.

Exit status 77: the tool isn't installed.
"""

from __future__ import annotations

import json
import sys

MISSING = 77


def libcosimpy(path: str, step: float, instant: float, signal: str) -> float:
    """libcosim; a step of zero takes the file's own."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    nanoseconds = round(step * 1e9)
    execution = CosimExecution.from_ssp_file(path, nanoseconds) if nanoseconds else CosimExecution.from_ssp_file(path)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    plant = execution.slave_index_from_instance_name("plant")
    references = {each.name.decode(): each.reference for each in execution.slave_variables(plant)}
    assert execution.simulate_until(target_time=round(instant * 1e9)), "libcosim failed on the way"
    return float(observer.last_real_values(slave_index=plant, variable_references=[references[signal]])[0])


def ecospy(path: str, step: float, instant: float, signal: str) -> float:
    """ecos."""
    from ecospy import EcosSimulation

    with EcosSimulation(ssp_path=path, step_size=step) as simulation:
        simulation.init()
        simulation.step_until(instant)
        return float(simulation.get_real(f"plant::{signal}"))


def omsimulator(path: str, step: float, instant: float, signal: str) -> float:
    """OMSimulator."""
    from OMSimulator import OMSimulator

    oms = OMSimulator()
    name, status = oms.importFile(path)
    assert status == 0, "OMSimulator can't import the file"
    oms.setFixedStepSize(name, step)
    oms.setStopTime(name, instant)
    for action in (oms.instantiate, oms.initialize, oms.simulate):
        assert action(name) == 0, f"OMSimulator: {action.__name__} failed"
    value, status = oms.getReal(f"{name}.{name}.plant.{signal}")
    assert status == 0, "OMSimulator has no such signal"
    return float(value)


TOOLS = {"libcosimpy": libcosimpy, "ecospy": ecospy, "OMSimulator": omsimulator}


def main() -> None:
    """Run the tool."""
    tool, path, step, instant, signal = sys.argv[1:]
    try:
        __import__(tool)
    except (ImportError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(MISSING)
    print(json.dumps({"value": TOOLS[tool](path, float(step), float(instant), signal)}))


if __name__ == "__main__":
    main()
