"""A robot that is stopped and waits for a person."""

from hexctl.control.guard import Guard
from hexctl.errors import RobotFaultError


class RobotStoppedError(RobotFaultError):
    """The guard, the robot's or this end's, has latched a stop; the session can be resumed after it.

    Attributes:
        reason: what the guard says.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


def check_not_stopped(servos: Guard) -> None:
    """Raise RobotStoppedError for a robot that must not move before somebody has looked at it."""
    if servos.stopped is not None:
        raise RobotStoppedError(f"the robot is stopped: {servos.stopped}", servos.stopped)
