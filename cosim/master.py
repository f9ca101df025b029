"""The master: advances a system of slaves on one time grid and records what they do."""

from __future__ import annotations

from enum import Enum


class Outcome(Enum):
    """How a simulation ended; the value is a sentence for people."""

    COMPLETED = "the simulation reached its stop time"
    INITIALISATION_FAILED = "a slave could not be initialised; check its parameters and start values"
    STEP_FAILED = "a slave failed within a communication step; the results end before it"
    NOT_FINITE = "a slave's output became infinite or not a number; the results end before it"
    INTERRUPTED = "the simulation was interrupted; the results end there"
