"""Who somebody on the network is, and what that lets them do."""

from enum import Enum


class Role(Enum):
    """Who opens a session; also the common name of its certificate, and of the folder that holds it.

    A robot listens and says; controllers command, stop and may say where a robot is; viewers only read.
    """

    ROBOT = "robot"
    CONTROLLER = "controller"
    VIEWER = "viewer"
