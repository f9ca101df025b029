"""What can go wrong between a symbolic model and a finished FMU; every message is one line with its remedy."""

from __future__ import annotations


class BuildError(RuntimeError):
    """An FMU could not be built or read; the message says what to do."""


class ModelError(BuildError):
    """The symbolic model contradicts its own contract: a function, a shape, a unit or a name."""


class StartError(ModelError):
    """A start value, the scene's, is outside the range that the model allows."""


class PlatformError(BuildError):
    """The platform is unknown to FMI 2.0, or this machine cannot build for it."""


class MissingCompilerError(PlatformError):
    """No C compiler was found."""


class CompileError(BuildError):
    """The C compiler or linker refused; carries its first error line."""


class ArchiveError(BuildError):
    """A file could not be written or read: missing, read-only, full or damaged."""


class CacheWarning(UserWarning):
    """What is built can't be cached; issued once for each folder."""
