"""The failures a user can cause, each with the exit code that the commands return for it."""

from __future__ import annotations


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
