"""Typed errors of the core.

Every error that a user can cause derives from `GrmmError` and its message is one sentence that says what is wrong and what
to do. The command line prints it and exits with 1; Blender operators pass it to `self.report`. Nothing else is caught there,
so a defect of ours still shows its traceback.
"""

from __future__ import annotations


class GrmmError(Exception):
    """Base of all errors whose message is meant for the user."""


class FileFormatError(GrmmError):
    """A file is corrupt, truncated, hostile, of another format, or of a version that cannot be read."""


class FileAccessError(GrmmError):
    """A file or folder is missing, not readable, not writable, or the disk is full."""


class ControlError(GrmmError):
    """A control name is unknown, or its value is not a finite number."""


class ShapeError(GrmmError):
    """An array has the wrong shape, data type or non-finite values."""


class ConfigError(GrmmError):
    """A model, training or capture configuration is inconsistent."""


class BackendError(GrmmError):
    """A rasteriser backend, device or optional library is not available."""


class RuntimeMissingError(BackendError):
    """Torch (or another part of the runtime) is needed and not installed here."""


class SessionError(GrmmError):
    """A session or its worker process failed, was closed, or ran out of memory."""


class CancelledError(GrmmError):
    """The user cancelled the job; what had been saved before is intact."""


class TrainingError(GrmmError):
    """Training cannot go on: the loss is not finite, or the data cannot be used; earlier checkpoints are intact."""


class NoFaceError(GrmmError):
    """No usable face in a photo."""
