"""Errors of building, reading and validating FMUs; every message is one line with its remedy."""

from __future__ import annotations

from flexfmu.errors import Error


class BuildError(Error, RuntimeError):
    """An FMU could not be built or read; the message says what to do."""


class ModelError(BuildError):
    """A symbolic model violates its contract: a function, a shape, a unit or a name."""


class StartError(ModelError):
    """A start value (from the scene) is outside its range in the model."""


class SettingError(BuildError):
    """An environment variable has a value that it can't have."""


class PlatformError(BuildError):
    """The platform is unknown to FMI 2.0, or this machine cannot build for it."""


class MissingCompilerError(PlatformError):
    """No C compiler was found."""


class CompileError(BuildError):
    """The C compiler or linker failed; the message contains its first error line.

    Attributes:
        undefined: symbols that nothing defines.
    """

    def __init__(self, message: str, undefined: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.undefined = undefined


class ArchiveError(BuildError):
    """A file could not be written or read: missing, read-only, full or damaged."""


class CacheWarning(UserWarning):
    """The cache's folder can't be written, or isn't its user's alone; issued once for each folder."""
