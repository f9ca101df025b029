"""The functions that a binary has to export (FMI 2.0.4, section 2.1 and fmi2Functions.h)."""

from __future__ import annotations

_COMMON = (
    "GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment EnterInitializationMode "
    "ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString "
    "GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate "
    "GetDirectionalDerivative"
)
_COSIMULATION = (
    "SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus GetIntegerStatus "
    "GetBooleanStatus GetStringStatus"
)
_EXCHANGE = (
    "EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates "
    "GetDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates"
)


def _names(text: str) -> frozenset[str]:
    return frozenset(f"fmi2{name}" for name in text.split())


COSIMULATION_FUNCTIONS = _names(f"{_COMMON} {_COSIMULATION}")
"""All functions of a co-simulation FMU."""

EXCHANGE_FUNCTIONS = _names(f"{_COMMON} {_EXCHANGE}")
"""All functions of a model exchange FMU."""
