"""Any failure in one line for the user, with the exit code of a command."""

from __future__ import annotations

from clgs.errors import ClgsError, DeviceError, LostDeviceError
from clgs.files import is_full

LOST = ("OUT_OF_RESOURCES", "DEVICE_NOT_AVAILABLE", "INVALID_COMMAND_QUEUE", "INVALID_CONTEXT")
"""What drivers answer once a device has failed, or is gone."""


def explain(error: Exception) -> tuple[str, int]:
    """One line for the user and the exit code."""
    if isinstance(error, ClgsError):
        return str(error), error.exit_code
    if isinstance(error, OSError):
        name = f"{error.filename}: " if error.filename is not None else ""
        remedy = "; free space and run it again" if is_full(error) else ""
        return f"{name}{error.strerror or error}{remedy}", ClgsError.exit_code
    if isinstance(error, MemoryError):
        return "out of memory", ClgsError.exit_code
    if isinstance(error, ImportError):
        name = error.name or "a library"
        if name.startswith("pyopencl"):
            remedy = "install it: pip install pyopencl"
            return f"pyopencl cannot be loaded ({error}); {remedy}", DeviceError.exit_code
        return f"{name} cannot be loaded ({error}); install clgs again", ClgsError.exit_code
    if type(error).__module__.startswith("pyopencl"):
        first = (str(error).strip().splitlines() or ["unknown error"])[0]
        line = f"OpenCL: {type(error).__name__}: {first}"
        if "MemoryError" in type(error).__name__:
            line = f"the device is out of memory ({first}); try a larger --downscale"
        elif any(code in first for code in LOST):
            line = str(LostDeviceError(first))
        return line, DeviceError.exit_code
    hint = "this is a bug in clgs; CLGS_DEBUG=1 shows where"
    return f"{type(error).__name__}: {error} ({hint})", ClgsError.exit_code
