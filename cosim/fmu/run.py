"""One run of an FMU: its failed step, saved states and end."""

from __future__ import annotations

from ctypes import byref, c_double, c_int, c_void_p
from functools import partial
from time import sleep

from flexfmu.cosim.errors import SlaveEnded, SlaveError
from flexfmu.cosim.fmu import calls as fmi2
from flexfmu.cosim.fmu.instance import FmuInstance

POLL = 1e-4
"""How long to wait until an FMU is asked again whether its step is done [s]."""


class FmuRun:
    """One run of an instance, from its start values to its end."""

    def __init__(self, instance: FmuInstance) -> None:
        self.instance = instance
        self.no_rollback = 1
        self._states: list[c_void_p] = []
        self._spare: list[c_void_p] = []

    def step_error(self, status: int, time: float, step: float) -> SlaveError:
        """What a failed step has to say, with the last time that the FMU reached."""
        reached, terminated = c_double(time), c_int(0)
        component, fmi = self.instance.component, self.instance.fmi
        error = self.instance.error(f"the step from {time:.9g} s by {step:.9g} s", status, time)
        if status != fmi2.DISCARD:
            return error
        fmi["fmi2GetRealStatus"](component, fmi2.LAST_SUCCESSFUL_TIME, byref(reached))
        fmi["fmi2GetBooleanStatus"](component, fmi2.TERMINATED, byref(terminated))
        if terminated.value:
            return SlaveEnded(error.slave, self.instance.log.complaint() or "fmi2Terminated", reached.value)
        return SlaveError(error.slave, error.reason, reached.value)

    def awaited(self, status: int) -> int:
        """The status of fmi2DoStep when its step is done, which goes on in the FMU after fmi2Pending."""
        pending = c_int(status)
        while pending.value == fmi2.PENDING:
            sleep(POLL)
            if (
                asked := self.instance.fmi["fmi2GetStatus"](
                    self.instance.component, fmi2.DO_STEP_STATUS, byref(pending)
                )
            ) > fmi2.WARNING:
                return int(asked)
        return int(pending.value)

    def save(self) -> object:
        """The complete state, in the memory of a released one where there is any."""
        state = self._spare.pop() if self._spare else c_void_p()
        call = partial(self.instance.fmi["fmi2GetFMUstate"], self.instance.component, byref(state))
        try:
            self.instance.check("saving the state", call)
        finally:
            # whatever it points to now must be freed at the end
            if state.value is not None and not any(each is state for each in self._states):
                self._states.append(state)
        self.no_rollback = 0
        return state

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one."""
        if isinstance(state, c_void_p) and not any(each is state for each in self._spare):
            self._spare.append(state)

    def restore(self, state: object) -> None:
        """Go back to a saved state."""
        call = partial(self.instance.fmi["fmi2SetFMUstate"], self.instance.component, state)
        self.instance.check("restoring a state", call)

    def free(self) -> None:
        """Free states and instance; to be called once."""
        if self.instance.alive:
            for state in self._states:
                self.instance.fmi["fmi2FreeFMUstate"](self.instance.component, byref(state))
        self.instance.free()
