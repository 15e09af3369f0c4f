"""Arbiter of commands of velocity and body pose from several sources.

Each source, such as a gamepad or ROS's `cmd_vel`, repeats its command before that expires. The arbiter
follows the source of the highest priority with a valid command. A released source commands zero, which holds
like any other command: the robot stops before it follows a lower source.

A body pose is commanded once, and held. A named source may command one only while it is followed.

    arbiter = Arbiter()
    stick = arbiter.source("gamepad")
    stick.command(Velocity(forward_m_s=0.1))
    arbiter.decide().velocity
    stick.release()

Sources may be used from any thread, `decide` only from the control loop.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from hexctl.errors import InputError, check_type
from hexctl.gait.body_pose import BodyPose
from hexctl.gait.gait import FINITE
from hexctl.time_source import WALL_TIME
from hexctl.types import FloatArray

#: Sources, lowest priority first; a stop outweighs them all. `motion` is for programs and trials.
SOURCES = ("motion", "cmd_vel", "keyboard", "gamepad", "page")

#: A command expires unless repeated within this time.
COMMAND_EXPIRY_S = 0.5


@dataclass(frozen=True, slots=True)
class Velocity:
    """Forward, left and counter-clockwise velocity in the body frame; raises InputError unless finite."""

    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    turn_rad_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("forward_m_s", "left_m_s", "turn_rad_s"):
            FINITE.check(name, getattr(self, name))
            object.__setattr__(self, name, float(getattr(self, name)))

    @property
    def array(self) -> FloatArray:
        """The three numbers, (3,)."""
        return np.array([self.forward_m_s, self.left_m_s, self.turn_rad_s])


ZERO = Velocity()


@dataclass(frozen=True, slots=True)
class Decision:
    """Decision of the arbiter.

    Attributes:
        source: None without a valid command.
        stopped: a reason, or None.
        freezes: whether the stop freezes all joints; otherwise the robot comes to a stand.
        pose: a new body pose since the last decision, or None.
    """

    velocity: Velocity = ZERO
    source: str | None = None
    stopped: str | None = None
    freezes: bool = False
    pose: BodyPose | None = None


class VelocitySource:
    """One source of an arbiter; `forgets` counts calls of `forget`, which void held and latched input."""

    def __init__(self, name: str, now_s: Callable[[], float], expiry_s: float | None) -> None:
        self.name = name
        self._now_s, self._expiry_s = now_s, expiry_s
        self._said: tuple[float, Velocity] | None = None  # replaced in one step, for readers in other threads
        self.forgets = 0

    def command(self, velocity: Velocity) -> None:
        """Ask for a velocity until the command expires."""
        check_type(velocity, Velocity, f"{self.name}: velocity", "a Velocity")
        self._said = self._now_s(), velocity

    def release(self) -> None:
        """Ask for a stand if anything was commanded before."""
        if self._said is not None:
            self.command(ZERO)

    def forget(self) -> None:
        """Withdraw the command: lower sources are followed now."""
        self.forgets += 1
        self._said = None

    def desired(self, now_s: float) -> Velocity | None:
        """The velocity asked for at a time; None if the command has expired, and before the first."""
        said = self._said
        if said is None:
            return None
        at_s, velocity = said
        # A clock that went back would make a command valid again.
        fresh = self._expiry_s is None or 0 <= now_s - at_s <= self._expiry_s
        return velocity if fresh else None


class Arbiter:
    """Decides which source the robot follows; commands expire on the monotonic clock, except `motion`."""

    def __init__(
        self, now_s: Callable[[], float] = WALL_TIME.now, *, expiry_s: float = COMMAND_EXPIRY_S
    ) -> None:
        if not 0 < expiry_s <= COMMAND_EXPIRY_S:
            raise InputError(
                f"expiry_s: got {expiry_s:g}; allowed: above 0 up to {COMMAND_EXPIRY_S:g}, in seconds"
            )
        self._now_s = now_s
        self._sources = {
            name: VelocitySource(name, now_s, None if name == "motion" else expiry_s) for name in SOURCES
        }
        self._stopped: str | None = None
        self._freezes = False
        self._pose: BodyPose | None = None
        self._latch = Lock()

    def source(self, name: str) -> VelocitySource:
        """The source of a name in `SOURCES`; raises InputError for another."""
        if name not in self._sources:
            raise InputError(f"source: got {name}; allowed: {', '.join(SOURCES)}")
        return self._sources[name]

    @property
    def stopped(self) -> str | None:
        """Why the robot is stopped, or None."""
        return self._stopped

    def stop(self, reason: str = "stop", *, stands: bool = False) -> None:
        """Freeze the robot until `clear`, or let it come to a stand; the first reason stays.

        A stop that freezes outweighs one that stands.
        """
        with self._latch:
            self._freezes = self._freezes or not stands
            if self._stopped is None:
                self._stopped = reason

    def clear(self) -> None:
        """Let velocities through again; earlier commands are forgotten, and nothing moves."""
        with self._latch:
            for source in self._sources.values():
                source.forget()
            self._stopped, self._freezes, self._pose = None, False, None

    def pose(self, pose: BodyPose, source: str | None = None) -> bool:
        """Command a body pose, and return whether it is taken.

        It is ignored while stopped, and from a named source that is not followed.
        """
        check_type(pose, BodyPose, "body pose", "a BodyPose")
        if source is not None and self._followed().source != source:
            return False
        with self._latch:
            self._pose = pose if self._stopped is None else None
            return self._pose is not None

    def decide(self) -> Decision:
        """The command of the highest source with a valid one, and a new body pose."""
        with self._latch:
            pose, self._pose = self._pose, None
            if self._stopped is not None:
                return Decision(stopped=self._stopped, freezes=self._freezes)
        return replace(self._followed(), pose=pose)

    def _followed(self) -> Decision:
        now_s = self._now_s()
        for name in reversed(SOURCES):
            velocity = self._sources[name].desired(now_s)
            if velocity is not None:
                return Decision(velocity, name)
        return Decision()
