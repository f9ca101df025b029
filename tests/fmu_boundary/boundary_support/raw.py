"""FMI calls as C makes them: every argument is passed as it is, every status comes back as a number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ctypes import byref, c_char, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = range(4)
CATEGORIES = {WARNING: "logStatusWarning", DISCARD: "logStatusDiscard", ERROR: "logStatusError"}


class Heard(NamedTuple):
    """What the FMU logged."""

    status: int
    category: str
    text: str


class RawInstance:
    """An instance behind fmpy's own bindings.

    Attributes:
        heard: all that it has logged.
        references: name → value reference of the real variables; inputs, settable and outputs hold some of the names.
    """

    def __init__(self, slave: Any, description: Any, heard: list[Heard]) -> None:
        self._slave, self.heard = slave, heard
        reals = [each for each in description.modelVariables if each.type == "Real"]
        self.references = {each.name: each.valueReference for each in reals}
        self.inputs = [each.name for each in reals if each.causality == "input"]
        self.settable = [each.name for each in reals if each.causality in ("input", "parameter")]
        self.outputs = [each.name for each in reals if each.causality == "output"]

    def call(self, function: str, *arguments: Any) -> int:
        """Status of a call; one that is refused must have said why, in the right category.

        Raises:
            AssertionError: it was refused without a sentence, or spoke of an error without being refused.
        """
        before = len(self.heard)
        status = int(self._slave._functions[function](self._slave.component, *arguments))
        said = [each for each in self.heard[before:] if each.status != OK]
        if status == OK:
            assert said == [], function
        else:
            assert [(each.status, each.category) for each in said] == [(status, CATEGORIES[status])], function
            assert len(said[0].text.split()) > 3, said
        return status

    def call_with_nothing(self, function: str) -> int:
        """Status of a call whose arguments are all zero, also of one that fmpy doesn't bind for this kind of instance."""
        doubles = {"fmi2DoStep": [c_double, c_double, c_int], "fmi2SetTime": [c_double]}
        exported = getattr(self._slave.dll, function)
        types = exported.argtypes[1:] if exported.argtypes else doubles.get(function, 4 * [c_void_p])
        return int(exported(c_void_p(self._slave.component), *(kind() for kind in types)))

    @property
    def sentence(self) -> str:
        """What was logged last."""
        return self.heard[-1].text

    def set(self, references: Sequence[int], values: Sequence[float]) -> int:
        """fmi2SetReal."""
        n = len(references)
        return self.call("fmi2SetReal", (c_uint * n)(*references), n, (c_double * n)(*values))

    def set_derivative(self, reference: int, order: int, value: float) -> int:
        """fmi2SetRealInputDerivatives for one of them."""
        arguments = ((c_uint * 1)(reference), 1, (c_int * 1)(order), (c_double * 1)(value))
        return self.call("fmi2SetRealInputDerivatives", *arguments)

    def get(self, references: Sequence[int]) -> tuple[int, list[float]]:
        """fmi2GetReal."""
        n = len(references)
        values = (c_double * n)(*[float("nan")] * n)
        return self.call("fmi2GetReal", (c_uint * n)(*references), n, values), list(values)

    def get_outputs(self) -> list[float]:
        """All outputs."""
        status, values = self.get([self.references[name] for name in self.outputs])
        assert status == OK, self.sentence
        return values

    def start(self, time: float = 0.0, stop: float | None = None) -> None:
        """From instantiation to the first step."""
        assert self.call("fmi2SetupExperiment", 0, 0.0, time, stop is not None, stop or 0.0) == OK
        assert self.call("fmi2EnterInitializationMode") == OK
        assert self.call("fmi2ExitInitializationMode") == OK

    def step(self, time: float, size: float) -> int:
        """fmi2DoStep."""
        return self.call("fmi2DoStep", time, size, 0)

    def last_time(self) -> float:
        """The last time that was reached."""
        value = c_double()
        assert self.call("fmi2GetRealStatus", LAST_SUCCESSFUL_TIME, byref(value)) == OK
        return value.value

    def save(self) -> c_void_p:
        """fmi2GetFMUstate."""
        state = c_void_p()
        assert self.call("fmi2GetFMUstate", byref(state)) == OK
        return state

    def free(self, state: c_void_p) -> int:
        """fmi2FreeFMUstate."""
        return self.call("fmi2FreeFMUstate", byref(state))

    def serialized(self, state: c_void_p) -> bytes:
        """The bytes of a state."""
        size = c_size_t()
        assert self.call("fmi2SerializedFMUstateSize", state, byref(size)) == OK
        buffer = (c_char * size.value)()
        assert self.call("fmi2SerializeFMUstate", state, buffer, size.value) == OK
        return buffer.raw

    def deserialized(self, content: bytes) -> tuple[int, c_void_p]:
        """Status and the state from those bytes."""
        state = c_void_p()
        buffer = (c_char * max(1, len(content))).from_buffer_copy(content or b"\0")
        return self.call("fmi2DeSerializeFMUstate", buffer, len(content), byref(state)), state


@contextmanager
def raw_instance(path: Path, folder: Path, kind: str = "co-simulation") -> Iterator[RawInstance]:
    """A new instance of an FMU that is unpacked in ``folder`` once."""
    description = fmpy.read_model_description(str(path))
    if not (folder / "modelDescription.xml").is_file():
        fmpy.extract(str(path), unzipdir=str(folder))
    heard: list[Heard] = []

    def hear(_environment: Any, _name: bytes, status: int, category: bytes, message: bytes) -> None:
        heard.append(Heard(status, category.decode(), message.decode()))

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(hear)
    slave = (FMU2Model if kind == "model exchange" else FMU2Slave)(
        guid=description.guid,
        modelIdentifier=description.coSimulation.modelIdentifier,
        unzipDirectory=str(folder),
        instanceName="raw",
    )
    slave.instantiate(callbacks=callbacks)
    try:
        yield RawInstance(slave, description, heard)
    finally:
        slave.freeInstance()
