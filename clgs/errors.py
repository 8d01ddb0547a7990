"""The failures a user can cause, each with the exit code that the commands return for it.

Any other failure, too, becomes one line for the user.
"""

from __future__ import annotations

from errno import EDQUOT, ENOSPC


class ClgsError(Exception):
    """One clear line for the user: what is wrong, where, and the remedy. Exit code 1."""

    exit_code = 1


class UsageError(ClgsError):
    """A setting or argument that cannot be used; names it and what is allowed. Exit code 2."""

    exit_code = 2


class OutputError(UsageError, OSError):
    """A name that nothing can be written to; says why, and the remedy. Exit code 2."""


class DataError(ClgsError):
    """Input data is missing, damaged or of an unknown kind. Exit code 3."""

    exit_code = 3


class ExistsError(OutputError, DataError):
    """What would be written exists already and was not to be replaced. Exit code 2."""

    exit_code = UsageError.exit_code


class CodecError(DataError):
    """A bitstream is not a .clgs file, or is damaged; names the section and offset. Exit code 3."""


class DeviceError(ClgsError):
    """No usable OpenCL device, or a kernel does not build. Exit code 4."""

    exit_code = 4


class LostDeviceError(DeviceError):
    """A device failed or is gone, and all that the process has on it; ``said``: by the driver."""

    def __init__(self, said: str) -> None:
        super().__init__(
            f"the OpenCL device failed or was lost ({said}), and this process cannot use it any "
            "more; start another one, a training with --resume; if it fails again, `clgs accept` "
            "shows where"
        )


class NoRoomError(DeviceError):
    """The device has no room for an array; ``problem`` says so without a remedy. Exit code 4."""

    def __init__(self, problem: str) -> None:
        super().__init__(f"{problem}; --max-memory, a smaller image or fewer anchors need less")
        self.problem = problem


class BudgetError(ClgsError):
    """A memory budget is below what a row of tiles needs: ``needed`` bytes. Exit code 1."""

    def __init__(self, problem: str, needed: int) -> None:
        super().__init__(problem)
        self.needed = needed


LOST = ("OUT_OF_RESOURCES", "DEVICE_NOT_AVAILABLE", "INVALID_COMMAND_QUEUE", "INVALID_CONTEXT")
"""What drivers answer once a device has failed, or is gone."""


def is_full(error: OSError) -> bool:
    """Whether the disk, or what the user may take of it, is full."""
    return error.errno in (ENOSPC, EDQUOT)


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
