"""A servo board that speaks MAVLink: 18 channels, several peers of which one commands, state at 50 Hz."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.mavlink import messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.messages import (
    FIRST_HIGH,
    IGNORE_US,
    LEAST_US,
    MOST_US,
    RELEASE_HIGH_US,
    RELEASE_LOW_US,
)
from hexctl.backends.mavlink.transport import Address, Arrival, MavlinkLink, Port, SequenceCount
from hexctl.control.guard import EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError, RobotFaultError
from hexctl.robot.servo_map import ServoMap
from hexctl.serve import board_telemetry
from hexctl.types import N_JOINTS, BoolArray, FloatArray, JointTargets, RobotState


class Channels:
    """What each channel was told last, by channel, (18,).

    Attributes:
        pulses_us: the pulse of each channel, within its limits; the last one where it is let go.
        active: which channels are driven.
        clipped: overrides so far of which a pulse limit changed something.
    """

    def __init__(self, servo_map: ServoMap) -> None:
        self._least_us = servo_map.by_channel(servo_map.min_us)
        self._most_us = servo_map.by_channel(servo_map.max_us)
        self.pulses_us: FloatArray = np.full(N_JOINTS, servo_map.centre_us)
        self.active: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.clipped = 0

    def take(self, raw: list[int]) -> None:
        """Take an override over, all channels or none.

        Raises CommandRefusedError for a pulse that no servo has.
        """
        values = np.array(raw)
        high = np.arange(N_JOINTS) >= FIRST_HIGH
        # Channels 9..18 are an extension whose missing values arrive as 0: nobody meant those.
        ignored = (values == IGNORE_US) | (high & (values == 0))
        let_go = np.where(high, values == RELEASE_HIGH_US, values == RELEASE_LOW_US)
        driven = ~ignored & ~let_go
        if not ((values[driven] >= LEAST_US) & (values[driven] <= MOST_US)).all():
            raise CommandRefusedError(
                f"override: got {raw}; allowed: pulses of {LEAST_US:g} to {MOST_US:g} microseconds"
            )
        limited = np.clip(values, self._least_us, self._most_us)
        self.clipped += bool((limited != values)[driven].any())
        self.pulses_us = np.where(driven, limited, self.pulses_us)
        self.active = (self.active & ~let_go) | driven

    def let_go(self) -> None:
        """Drive no channel any more."""
        self.active = np.zeros(N_JOINTS, dtype=bool)


#: Others that the board speaks to at one time.
MOST_PEERS = 8

#: A peer that was silent for this long is forgotten.
FORGET_AFTER_S = 5.0

#: Whoever commands loses the board to the next who wants it after this silence; heartbeats come every second.
FREE_AFTER_S = 2.5


@dataclass(eq=False, slots=True)
class Peer:
    """Another end.

    Attributes:
        address: where it speaks from, None on a stream.
        system: who it says it is.
        component: which part of it.
        heard_at_s: when it said something last, on time.monotonic.
        told_at_s: when it was told last that another commands.
        sequence: its lost frames.
    """

    address: Address
    system: int
    component: int
    heard_at_s: float
    told_at_s: float = float("-inf")
    sequence: SequenceCount = field(default_factory=SequenceCount)


class Peers:
    """The peers heard lately, and the one of them that commands.

    Attributes:
        commander: whoever moves the servos, or None.
        lost: frames of all peers so far that never came.
        out_of_order: frames that came too late or twice.
        crowded_out: peers so far that were forgotten because others came.
    """

    def __init__(self) -> None:
        self._known: list[Peer] = []
        self.commander: Peer | None = None
        self._lost_before = self._late_before = 0
        self.crowded_out = 0

    @property
    def lost(self) -> int:
        """Return how many frames never came."""
        return self._lost_before + sum(peer.sequence.lost for peer in self._known)

    @property
    def out_of_order(self) -> int:
        """Return how many frames came too late or twice."""
        return self._late_before + sum(peer.sequence.out_of_order for peer in self._known)

    def addresses(self) -> list[Address]:
        """Return where to send what is for all; a stream has the one address None."""
        return list(dict.fromkeys(peer.address for peer in self._known))

    def hear(self, address: Address, system: int, component: int, at_s: float) -> tuple[Peer, bool]:
        """Return who said something, and whether it is new."""
        for peer in [peer for peer in self._known if at_s - peer.heard_at_s > FORGET_AFTER_S]:
            self._drop(peer)
        for peer in self._known:
            if (peer.address, peer.system, peer.component) == (address, system, component):
                peer.heard_at_s = at_s
                return peer, False
        if len(self._known) >= MOST_PEERS:
            # The quietest goes: a flood of senders must not keep out whoever wants to command.
            others = [peer for peer in self._known if peer is not self.commander]
            self._drop(min(others, key=lambda peer: peer.heard_at_s))
            self.crowded_out += 1
        self._known.append(Peer(address, system, component, at_s))
        return self._known[-1], True

    def may_command(self, peer: Peer, at_s: float) -> bool:
        """Return whether a peer commands, or may begin to because nobody else does."""
        holder = self.commander
        return holder is None or holder is peer or at_s - holder.heard_at_s > FREE_AFTER_S

    def farewell(self, peer: Peer) -> None:
        """Forget a peer that says that it ends; the next may command at once."""
        self._drop(peer)
        if peer is self.commander:
            self.commander = None

    def _drop(self, peer: Peer) -> None:
        self._known.remove(peer)
        self._lost_before += peer.sequence.lost
        self._late_before += peer.sequence.out_of_order


#: Without anybody who commands for this long, the servos are let go.
RELEASE_AFTER_S = 10.0

#: The next tick is left alone for this long before it is due, so that it is not late.
SPARE_S = 0.0003

#: Heartbeat and health go out every so many ticks, angles for displays every so many.
BEAT_TICKS = 50
EULER_TICKS = 5

#: A peer that may not command is told so no more often than this.
TELL_EVERY_S = 1.0

CRITICAL_SEVERITY, WARNING_SEVERITY = 2, 4


@dataclass(slots=True)
class BoardCounters:
    """What the board did since it began.

    Attributes:
        overrides: obeyed.
        refused: with a pulse that no servo has, or while the robot is stopped.
        of_others: of peers that do not command.
        expired: times that the commands ran out, and the pose was held.
        released: times that the servos were let go.
        ticks: control periods.
    """

    overrides: int = 0
    refused: int = 0
    of_others: int = 0
    expired: int = 0
    released: int = 0
    ticks: int = 0


class ServoBoard:
    """Moves connected-to-be servos from what comes on a port.

    Commands expire after `expiry_s`: then the pose is held. Without whoever commanded for `release_after_s`,
    its heartbeat included, the servos are let go. The guard looks after ranges, speeds and falls here too.
    """

    def __init__(
        self,
        servos: LegServos,
        servo_map: ServoMap,
        port: Port,
        *,
        signing_key: bytes | None = None,
        expiry_s: float = EXPIRY_S,
        release_after_s: float = RELEASE_AFTER_S,
    ) -> None:
        self._guard = Guard(servos, expiry_s=expiry_s)
        self._map = servo_map
        codec = Codec(messages.BOARD_SYSTEM, messages.BOARD_COMPONENT, signing_key=signing_key)
        self._link = MavlinkLink(port, codec)
        self._release_after_s = release_after_s
        self._channels = Channels(servo_map)
        self._peers = Peers()
        self._stream = not port.datagrams
        self._counters = BoardCounters()
        self._commanded = False
        self._heard_at_s = 0.0

    def run(self, until: Callable[[], bool], *, ready: Callable[[], None] = lambda: None) -> None:
        """Serve until asked to stop; `ready` is called once others may speak.

        Raises RobotFaultError when the servos cannot be had, or they or the port have gone.
        """
        try:
            with self._guard:
                self._guard.clock.tick()
                ready()
                while not until():
                    self._listen()
                    self._tick()
        except OSError as error:
            raise RobotFaultError(f"the board's port has gone: {error.strerror or error}") from error
        finally:
            self._link.close()

    def report(self) -> dict[str, Any]:
        """Return what happened so far, as JSON values."""
        return {
            **asdict(self._counters),
            "clipped": self._channels.clipped + self._guard.counters.clipped,
            "lost": self._peers.lost,
            "out_of_order": self._peers.out_of_order,
            "crowded_out": self._peers.crowded_out,
            "malformed": self._link.malformed,
            "dropped": self._link.dropped,
            "overruns": self._guard.clock.overruns,
            "stopped": self._guard.stopped,
        }

    def _listen(self) -> None:
        """Do what the port asks for until the next tick is due."""
        while (patience_s := self._guard.clock.due_in_s - SPARE_S) > 0:
            for arrival in self._link.receive(patience_s):
                self._handle(arrival)
        for arrival in self._link.receive(0.0):  # even when a tick took all its time
            self._handle(arrival)

    def _handle(self, arrival: Arrival) -> None:
        """Obey or answer one message; nothing that comes may end the loop."""
        frame = arrival.frame
        peer, new = self._peers.hear(arrival.sender, frame.system, frame.component, arrival.at_s)
        if not peer.sequence.in_order(frame.sequence, arrival.at_s):
            return
        if new:
            self._introduce(peer)
        if peer is self._peers.commander:
            self._heard_at_s = arrival.at_s
        if frame.kind == "RC_CHANNELS_OVERRIDE" and _for_us(frame.message):
            self._override(frame.message, peer, arrival.at_s)
        elif frame.kind == "HEARTBEAT":
            if frame.message.system_status == messages.POWEROFF:
                self._peers.farewell(peer)
        elif frame.kind == "PING" or (frame.kind == "COMMAND_LONG" and _for_us(frame.message)):
            for answer in board_telemetry.answers(frame.kind, frame.message, peer.system, peer.component):
                self._link.send(answer, peer.address)

    def _override(self, message: Any, peer: Peer, at_s: float) -> None:
        """Move the servos if the sender may."""
        if not self._peers.may_command(peer, at_s):
            self._counters.of_others += 1
            if at_s - peer.told_at_s > TELL_EVERY_S:
                peer.told_at_s = at_s
                words = "another controller holds the servos"
                self._link.send(board_telemetry.text(CRITICAL_SEVERITY, words), peer.address)
            return
        if peer is not self._peers.commander:
            # Whoever is new begins anew: a fall or a fault of the one before is over.
            self._peers.commander = peer
            self._guard.clear()
        if self._guard.stopped == "expired":
            self._guard.clear()
        self._heard_at_s = at_s
        try:
            self._channels.take(messages.channels_of(message))
            self._move()
        except (CommandRefusedError, EStopError):
            self._counters.refused += 1
            return
        self._counters.overrides += 1

    def _move(self) -> None:
        """Send the servos where the channels say; those that are let go stay as they were told last."""
        channels = self._channels
        if not channels.active.any():
            self._let_go()
            return
        active = channels.active[self._map.channels - 1]
        wanted = self._map.to_rad(channels.pulses_us)
        wanted[~active] = self._guard.accepted_rad()[~active]
        self._guard.write(JointTargets(wanted, self._guard.clock.now_s))
        self._commanded = True

    def _let_go(self) -> None:
        self._channels.let_go()
        self._guard.disable_torque()
        self._guard.pause_watchdog()
        self._counters.released += 1
        self._commanded = False

    def _tick(self) -> None:
        """Let one control period pass: look after silence and say how the servos are."""
        self._guard.clock.tick()
        expired_before = self._guard.stopped == "expired"
        state = self._guard.read()
        self._counters.expired += not expired_before and self._guard.stopped == "expired"
        if self._commanded and time.monotonic() - self._heard_at_s > self._release_after_s:
            self._let_go()
            self._peers.commander = None
        self._say(self._news(state))
        self._counters.ticks += 1

    def _news(self, state: RobotState) -> list[Any]:
        """Return what to say of a state, and now and then how the board is."""
        ticks, now_s = self._counters.ticks, time.monotonic()
        pulses = self._map.by_channel(self._map.pulses_us(state.joint_positions_rad))
        said = [board_telemetry.outputs(pulses, self._channels.active, now_s)]
        said += board_telemetry.pose(state, now_s, with_euler=ticks % EULER_TICKS == 0)
        if ticks % BEAT_TICKS == 0:
            said = [*self._introduction(state.measured), *said]
            said += board_telemetry.health(state, errors=self._link.malformed)
        return said

    def _introduction(self, measured: bool) -> list[Any]:
        """Return who the board is: it beats, and says what its joint positions are worth."""
        said = [
            board_telemetry.beat(self._system_state()),
            board_telemetry.measured(measured, time.monotonic()),
        ]
        if self._guard.stopped not in (None, "expired"):
            said.append(board_telemetry.text(WARNING_SEVERITY, f"stopped: {self._guard.stopped}"))
        return said

    def _introduce(self, peer: Peer) -> None:
        """Let a new peer know at once who is here."""
        for message in self._introduction(self._guard.read().measured):
            self._link.send(message, peer.address)

    def _system_state(self) -> int:
        """Return the MAV_STATE: standing by, active, or critical while the pose is held."""
        if self._guard.stopped is not None:
            return int(messages.CRITICAL)
        return int(messages.ACTIVE if self._commanded else messages.STANDBY)

    def _say(self, said: list[Any]) -> None:
        """Send to everybody who was heard lately; on a stream whoever is there hears it."""
        for address in [None] if self._stream else self._peers.addresses():
            for message in said:
                self._link.send(message, address)


def _for_us(message: Any) -> bool:
    """Return whether a message is for this board; 0 is for everybody."""
    return message.target_system in (0, messages.BOARD_SYSTEM) and message.target_component in (
        0,
        messages.BOARD_COMPONENT,
    )
