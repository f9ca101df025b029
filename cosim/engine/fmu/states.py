"""The saved states of an FMU's instance over one run, and the end of both."""

from __future__ import annotations

from ctypes import c_void_p
from typing import cast

from flexfmu.cosim.engine.fmu.instance import Instance


class FmuStates:
    """Saved states of an instance: their memory is used again, and freed with the instance at the end of a run."""

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self.no_rollback = 1
        self._states: list[c_void_p] = []
        self._spare: list[c_void_p] = []

    def save(self) -> object:
        """The complete state, in the memory of a released one where there is any."""
        state = self._spare.pop() if self._spare else c_void_p()
        try:
            self.instance.check("saving the state", lambda: self.instance.get_state(state))
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
        saved = cast(c_void_p, state)
        self.instance.check("restoring a state", lambda: self.instance.set_state(saved))

    def free(self) -> None:
        """Free states and instance; to be called once."""
        if self.instance.alive:
            for state in self._states:
                self.instance.free_state(state)
        self.instance.free()
