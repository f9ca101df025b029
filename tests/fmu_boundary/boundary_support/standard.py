"""Which FMI function may be called in which state: the tables of FMI 2.0.4, sections 3.2.3 (model exchange) and 4.2.4.

The states "step in progress" and "step canceled" are those of asynchronous steps, which our FMUs don't make; "error" is left to
the importer: after a refused call the instance is where it was.
"""

from __future__ import annotations

_CO_SIMULATION = """
                              instantiated  initialization  complete  failed  terminated
fmi2SetDebugLogging                x              x             x        x        x
fmi2SetupExperiment                x              -             -        -        -
fmi2EnterInitializationMode        x              -             -        -        -
fmi2ExitInitializationMode         -              x             -        -        -
fmi2Terminate                      -              -             x        x        -
fmi2Reset                          x              x             x        x        x
fmi2GetReal                        +              x             x        x        x
fmi2GetInteger                     +              x             x        x        x
fmi2GetBoolean                     -              x             x        x        x
fmi2GetString                      -              x             x        x        x
fmi2SetReal                        x              x             x        +        -
fmi2SetInteger                     x              x             x        +        -
fmi2SetBoolean                     x              x             x        +        -
fmi2SetString                      x              x             x        +        -
fmi2GetFMUstate                    x              x             x        x        x
fmi2SetFMUstate                    x              x             x        x        x
fmi2FreeFMUstate                   x              x             x        x        x
fmi2SerializedFMUstateSize         x              x             x        x        x
fmi2SerializeFMUstate              x              x             x        x        x
fmi2DeSerializeFMUstate            x              x             x        x        x
fmi2GetDirectionalDerivative       -              x             x        x        x
fmi2SetRealInputDerivatives        x              x             x        +        -
fmi2GetRealOutputDerivatives       -              +             x        x        x
fmi2DoStep                         -              -             x        +        -
fmi2CancelStep                     -              -             -        -        -
fmi2GetStatus                      -              -             x        x        x
fmi2GetRealStatus                  -              -             x        x        x
fmi2GetIntegerStatus               -              -             x        x        x
fmi2GetBooleanStatus               -              -             x        x        x
fmi2GetStringStatus                -              -             x        x        x
"""

_MODEL_EXCHANGE = """
                                   instantiated  initialization  event  continuous  terminated
fmi2SetDebugLogging                    x              x             x        x           x
fmi2SetupExperiment                    x              -             -        -           -
fmi2EnterInitializationMode            x              -             -        -           -
fmi2ExitInitializationMode             -              x             -        -           -
fmi2Terminate                          -              -             x        x           -
fmi2Reset                              x              x             x        x           x
fmi2GetReal                            +              x             x        x           x
fmi2GetInteger                         +              x             x        x           x
fmi2GetBoolean                         -              x             x        x           x
fmi2GetString                          -              x             x        x           x
fmi2SetReal                            x              x             x        x           -
fmi2SetInteger                         x              x             x        -           -
fmi2SetBoolean                         x              x             x        -           -
fmi2SetString                          x              x             x        -           -
fmi2GetFMUstate                        x              x             x        x           x
fmi2SetFMUstate                        x              x             x        x           x
fmi2FreeFMUstate                       x              x             x        x           x
fmi2SerializedFMUstateSize             x              x             x        x           x
fmi2SerializeFMUstate                  x              x             x        x           x
fmi2DeSerializeFMUstate                x              x             x        x           x
fmi2GetDirectionalDerivative           -              x             x        x           x
fmi2EnterEventMode                     -              -             x        x           -
fmi2NewDiscreteStates                  -              -             x        -           -
fmi2EnterContinuousTimeMode            -              -             x        -           -
fmi2CompletedIntegratorStep            -              -             -        x           -
fmi2SetTime                            -              -             x        x           -
fmi2SetContinuousStates                -              -             -        x           -
fmi2GetDerivatives                     -              +             x        x           x
fmi2GetEventIndicators                 -              x             x        x           x
fmi2GetContinuousStates                -              x             x        x           x
fmi2GetNominalsOfContinuousStates      x              +             x        x           x
"""
"""x: allowed, +: allowed by our FMUs beyond the standard, -: refused."""


def _marks(table: str, states: tuple[str, ...]) -> dict[str, dict[str, str]]:
    rows = (line.split() for line in table.splitlines()[2:])
    return {name: dict(zip(states, marks, strict=True)) for name, *marks in rows}


MARKS = {
    "co-simulation": _marks(
        _CO_SIMULATION, ("instantiated", "initialization", "step complete", "step failed", "terminated")
    ),
    "model exchange": _marks(
        _MODEL_EXCHANGE, ("instantiated", "initialization", "event mode", "continuous-time mode", "terminated")
    ),
}
"""Kind of instance → function → state → mark."""

STATES = [(kind, state) for kind, marks in MARKS.items() for state in marks["fmi2Reset"]]
"""All states of all kinds of instances."""


def is_allowed(kind: str, function: str, state: str) -> bool:
    """Whether our FMUs serve the call in that state."""
    return MARKS[kind][function][state] != "-"
