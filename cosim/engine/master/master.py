"""The master: simulates a system of slaves on one time grid and records their outputs."""

from __future__ import annotations

from flexfmu.cosim.engine.master.algorithms import Algorithm
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
    isolation: float | None = None,
) -> Simulation:
    """Co-simulate a system from ``start`` to ``stop`` [s].

    Communication points are start + n * step, every breakpoint and every sample instant, met exactly. At one instant
    outputs are exchanged in the order of direct feedthrough, and algebraic loops are solved if the system has a solver.
    Over a step an input follows the polynomial that its source predicts, if it does; else the algorithm interpolates it
    between both ends of the step or extrapolates it from the beginning. The degree of the polynomial follows from the
    derivatives that the source gives and the target takes.

    Every run ends by terminating the slaves. A failing slave doesn't raise an exception: see `Simulation.outcome`; the
    recording ends with the last completed step.

    Args:
        system: slaves and connections.
        stop, start: [s].
        step: communication step [s]; with step control the length of the first one.
        tolerance: relative tolerance for the slaves' own integrators; None for their default.
        progress: called during the run with the simulated fraction, 0..1.
        algorithm: how slaves are coupled over a step: `GaussSeidel` (when None), `Jacobi` or `Implicit`.
        step_control: chooses the communication steps; None for a constant step.
        compiled: True or None to run the loop over the points in C if the system allows it (no step control, no loops
            to iterate) and there is a C compiler, False for Python; the results are the same.
        record: which outputs to record, with how many derivatives.
        isolation: for a run in a child process the longest duration of one call of a slave [s], `CALL_LIMIT` for example; a
            slave that crashes, exits or hangs ends only the run, and what slaves change in their own attributes stays
            there. None for this process.

    Returns:
        Recording, outcome, message and delays.

    Raises:
        InputError: the time grid is invalid, a sample time doesn't fit it, a slave needs equal steps but doesn't get
            them, a slave would have to be rolled back but can't save its state, or a signal to record doesn't exist.
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
