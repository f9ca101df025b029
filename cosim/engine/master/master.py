"""The master: advances a system of slaves on one time grid and records what they do."""

from __future__ import annotations

from flexfmu.cosim.engine.master.algorithms import Algorithm
from flexfmu.cosim.engine.master.isolation import Isolation
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.master.simulation_loop import Progress
from flexfmu.cosim.engine.master.simulator import Simulator
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.results import EVERYTHING, Selection

__all__ = ["Outcome", "Progress", "Simulation", "simulate"]


def simulate(
    system: System,
    stop: float,
    step: float,
    *,
    start: float = 0.0,
    tolerance: float | None = None,
    progress: Progress | None = None,
    algorithm: Algorithm | None = None,
    step_control: StepDoubling | None = None,
    compiled: bool | None = None,
    record: Selection = EVERYTHING,
    isolation: Isolation | None = None,
) -> Simulation:
    """Co-simulate a system from ``start`` to ``stop`` [s].

    Communication points are start + n * step, every breakpoint and every sample instant, hit exactly. At one instant
    outputs are exchanged in the order of direct feedthrough, and algebraic loops are solved if the system has a solver.
    Over a step an input follows the polynomial that its source announced; else it interpolates between both ends of the
    step or extrapolates from its beginning, as the algorithm has it. Its degree follows from the derivatives that
    source and target can handle.

    Every run ends by terminating the slaves. A failing slave doesn't raise: the outcome says so, and the recording has
    everything up to the last completed step.

    Args:
        system: slaves and connections.
        stop, start: [s].
        step: communication step [s]; with step control the first one.
        tolerance: relative tolerance for the slaves' own integrators; None for their default.
        progress: called now and then with the simulated fraction.
        algorithm: how slaves are coupled over a step: `GaussSeidel` (when None), `Jacobi` or `Implicit`.
        step_control: chooses the communication steps; None for a constant step.
        compiled: True or None to run the loop over the points in C where the system allows it (no steps are repeated)
            and there is a C compiler, False for Python; the numbers are the same.
        record: which outputs to record, with how many derivatives.
        isolation: for a run in a child process: a slave that crashes, exits or hangs ends the run alone; what slaves change
            in themselves stays there. None for this process.

    Raises:
        InputError: the time grid makes no sense, a sample time doesn't fit it, a slave would have to be taken back to an
            earlier state but can't, or there is no such signal to record.
    """
    simulator = Simulator(
        system,
        stop,
        step,
        start=start,
        algorithm=algorithm,
        step_control=step_control,
        compiled=compiled,
        record=record,
        isolation=isolation,
    )
    return simulator.run(tolerance, progress)
