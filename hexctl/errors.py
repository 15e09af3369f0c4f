"""The errors hexctl raises on purpose, each also a built-in error.

Every message says what was wrong, the value got, what is allowed and, where it helps, what to do next.
"""


class HexctlError(Exception):
    """Anything hexctl refuses or cannot do; its text is one line for the user."""


class InputError(HexctlError, ValueError):
    """A value from the user (option, file, argument) that is not allowed."""


class MissingExtraError(HexctlError, ImportError):
    """An optional part of hexctl is not installed."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f'{what} needs the "{extra}" extra: pip install "hexctl[{extra}]"')
        self._what, self._extra = what, extra

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self._what, self._extra)


#: Which extra brings a package that hexctl does without otherwise.
EXTRAS = {
    "mujoco": "sim",
    "dm_control": "sim",
    "rerun": "view",
    "rerun_cli": "view",
    "pyarrow": "study",
    "matplotlib": "study",
    "distributed": "study",
}


class ReachError(HexctlError, ValueError):
    """A foot position that a leg cannot reach."""


class LimitError(HexctlError, ValueError):
    """A joint angle or speed outside its limits."""


class CommandRefusedError(HexctlError, ValueError):
    """The guard did not accept a command; the last accepted targets stay in force."""


class EStopError(HexctlError, RuntimeError):
    """The guard has latched a stop; nothing moves until it is cleared explicitly."""


class RobotFaultError(HexctlError, RuntimeError):
    """The robot or the link to it does not do what it must."""


class SimulationDivergedError(RobotFaultError):
    """The physics has become unstable; states after this are meaningless."""


class MessageError(HexctlError, ValueError):
    """Bytes from the network that are not what they should be; they are dropped and counted."""


class RecordingError(HexctlError, OSError):
    """A recording could not be written or opened."""
