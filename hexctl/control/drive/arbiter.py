"""Velocity commands from several sources: which of them the robot follows.

Each source, such as a gamepad or ROS's `cmd_vel`, says what it wants, and has to say it again before its
command expires. The arbiter follows the source of the highest priority that has spoken lately. A source that
is let go of says zero explicitly, which holds like any other command: the robot comes to a stand first,
before a lower source moves it again.

    arbiter = Arbiter()
    stick = arbiter.source("gamepad")
    stick.command(Velocity(forward_m_s=0.1))
    arbiter.decide().velocity
    stick.release()

Sources may be used from any thread, `decide` belongs to the loop that walks.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np

from hexctl.errors import InputError, check_type
from hexctl.types import FloatArray

#: Sources, the lowest priority first; a stop outweighs them all. `motion` is what a program or a trial wants
#: while no other source has spoken lately.
SOURCES = ("motion", "cmd_vel", "keyboard", "gamepad", "page")

#: A command that is not repeated for so long is followed no more.
COMMAND_EXPIRY_S = 0.5


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity of the body in its own frame.

    Attributes:
        forward_m_s: to the front.
        left_m_s: to the left.
        turn_rad_s: counter-clockwise.

    Raises InputError for numbers that are not finite.
    """

    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    turn_rad_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("forward_m_s", "left_m_s", "turn_rad_s"):
            value = getattr(self, name)
            check_type(value, float, name)
            if not math.isfinite(value):
                raise InputError(f"{name}: got {value}; allowed: a finite number")
            object.__setattr__(self, name, float(value))

    @property
    def array(self) -> FloatArray:
        """The three numbers, (3,)."""
        return np.array([self.forward_m_s, self.left_m_s, self.turn_rad_s])


#: No motion.
ZERO = Velocity()


@dataclass(frozen=True, slots=True)
class Decision:
    """What the robot is to do now.

    Attributes:
        velocity: the one to walk with.
        source: whose it is, one of `SOURCES`; None where none has spoken lately.
        stopped: why the robot is stopped, or None.
    """

    velocity: Velocity = ZERO
    source: str | None = None
    stopped: str | None = None


class VelocitySource:
    """One source of an arbiter; made by `Arbiter.source`.

    Args:
        name: one of `SOURCES`.
        now_s: time, on the arbiter's clock.
        expiry_s: for how long a command holds; None for as long as no other comes.

    Attributes:
        forgets: how often it was told to forget. What is held or latched from before does not count after it.
    """

    def __init__(self, name: str, now_s: Callable[[], float], expiry_s: float | None) -> None:
        self.name = name
        self._now_s, self._expiry_s = now_s, expiry_s
        self._said: tuple[float, Velocity] | None = None  # replaced as a whole: no reader sees half of it
        self.forgets = 0

    def command(self, velocity: Velocity) -> None:
        """Ask for a velocity, from now until the command expires."""
        check_type(velocity, Velocity, f"{self.name}: velocity", "a Velocity")
        self._said = self._now_s(), velocity

    def release(self) -> None:
        """Ask for a stand, as a hand that lets go; without a command before, nothing."""
        if self._said is not None:
            self.command(ZERO)

    def forget(self) -> None:
        """Ask for nothing any more: lower sources follow now."""
        self.forgets += 1
        self._said = None

    def wanted(self, now_s: float) -> Velocity | None:
        """The velocity asked for at a time; None for a command that has expired, and before the first."""
        said = self._said
        if said is None:
            return None
        at_s, velocity = said
        # A clock that went back would make a command young again.
        fresh = self._expiry_s is None or 0 <= now_s - at_s <= self._expiry_s
        return velocity if fresh else None


class Arbiter:
    """Decides whose velocity the robot follows.

    Args:
        now_s: monotonic time in s; commands are stamped by it as they arrive.
        expiry_s: for how long a command holds, in s; `motion` holds until it is changed.
    """

    def __init__(
        self, now_s: Callable[[], float] = time.monotonic, *, expiry_s: float = COMMAND_EXPIRY_S
    ) -> None:
        check_type(expiry_s, float, "expiry_s")
        if not 0 < expiry_s <= COMMAND_EXPIRY_S:
            raise InputError(
                f"expiry_s: got {expiry_s:g}; allowed: above 0 up to {COMMAND_EXPIRY_S:g}, in seconds"
            )
        self._now_s = now_s
        self._sources = {
            name: VelocitySource(name, now_s, None if name == "motion" else expiry_s) for name in SOURCES
        }
        self._stopped: str | None = None
        self._latch = Lock()

    def source(self, name: str) -> VelocitySource:
        """The source of a name in `SOURCES`; raises InputError for another."""
        if name not in self._sources:
            raise InputError(f"source: got {name}; allowed: {', '.join(SOURCES)}")
        return self._sources[name]

    @property
    def stopped(self) -> str | None:
        """Why nothing moves, or None."""
        return self._stopped

    def stop(self, reason: str = "stop") -> None:
        """Let no velocity through until `clear`; the first reason stays."""
        with self._latch:
            if self._stopped is None:
                self._stopped = reason

    def clear(self) -> None:
        """Let velocities through again; what was asked for before is forgotten, so that nothing moves."""
        with self._latch:
            for source in self._sources.values():
                source.forget()
            self._stopped = None

    def decide(self) -> Decision:
        """What the robot is to do now: the command of the highest source that has spoken lately."""
        if self._stopped is not None:
            return Decision(stopped=self._stopped)
        now_s = self._now_s()
        for name in reversed(SOURCES):
            velocity = self._sources[name].wanted(now_s)
            if velocity is not None:
                return Decision(velocity, name)
        return Decision()
