"""A servo board that speaks MAVLink: 18 channels, several peers of which one commands, state at 50 Hz."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.backends.mavlink.mavlink_messages import (
    FIRST_HIGH,
    IGNORE_US,
    LEAST_US,
    MOST_US,
    RELEASE_HIGH_US,
    RELEASE_LOW_US,
)
from hexctl.backends.mavlink.mavlink_transport import Address, MavlinkLink, Port, SequenceCount
from hexctl.control.guard import EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.simulators import board_messages
from hexctl.simulators.board_messages import answers, for_us
from hexctl.simulators.simulated_board import RunningBoard
from hexctl.types import N_JOINTS, BoolArray, FloatArray, JointTargets, RobotState

#: After a silence, overrides must come for so long to count without a confirming heartbeat. A controller
#: without states continues for `EXPIRY_S`: a delayed link carries that much after it has stopped.
RESUME_AFTER_S = 1.5 * EXPIRY_S


class OverrideStream:
    """Time for which overrides of the commander have come without a silence, the last one at `at_s`."""

    def __init__(self, silence_s: float = EXPIRY_S) -> None:
        self._silence_s = silence_s
        self._since_s = self.at_s = float("-inf")

    def note(self, at_s: float) -> None:
        """Note an override."""
        if at_s - self.at_s > self._silence_s:
            self._since_s = at_s
        self.at_s = at_s

    @property
    def steady(self) -> bool:
        """Whether overrides have come long enough for a present controller."""
        return self.at_s - self._since_s >= RESUME_AFTER_S


class Channels:
    """Last override of each servo channel, (18,): pulses within the limits, and which channels are driven.

    `clipped` counts overrides that a pulse limit changed.
    """

    def __init__(self, servo_map: ServoMap) -> None:
        self._least_us = servo_map.by_channel(servo_map.least)
        self._most_us = servo_map.by_channel(servo_map.most)
        self.pulses_us: FloatArray = servo_map.by_channel(servo_map.centre)
        self.active: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.clipped = 0

    def take(self, raw: list[int]) -> None:
        """Apply an override to all channels or none; raises CommandRefusedError for an impossible pulse."""
        values = np.array(raw)
        released, driven = _released_and_driven(raw)
        if not ((values[driven] >= LEAST_US) & (values[driven] <= MOST_US)).all():
            raise CommandRefusedError(
                f"override: got {raw}; allowed: pulses of {LEAST_US:g} to {MOST_US:g} microseconds"
            )
        limited = np.clip(values, self._least_us, self._most_us)
        self.clipped += bool((limited != values)[driven].any())
        self.pulses_us = np.where(driven, limited, self.pulses_us)
        self.active = (self.active & ~released) | driven

    def release(self) -> None:
        """Release all channels."""
        self.active = np.zeros(N_JOINTS, dtype=bool)

    def released_by(self, raw: list[int]) -> bool:
        """Whether an override leaves no channel driven."""
        released, driven = _released_and_driven(raw)
        return not (driven | (self.active & ~released)).any()


def _released_and_driven(raw: list[int]) -> tuple[BoolArray, BoolArray]:
    """Which channels an override (18,) releases, and which it drives; others are unchanged."""
    values, high = np.array(raw), np.arange(N_JOINTS) >= FIRST_HIGH
    # Channels 9..18 are an extension whose missing values arrive as 0: ignored.
    ignored = (values == IGNORE_US) | (high & (values == 0))
    released = np.where(high, values == RELEASE_HIGH_US, values == RELEASE_LOW_US)
    return released, ~ignored & ~released


#: Most peers that the board answers at one time; others wait for a place.
MOST_PEERS = 8

#: A new peer keeps its place for so long: enough to show that it receives states.
PROVE_S = 0.5

#: A peer is dropped after this silence.
FORGET_AFTER_S = 5.0

#: The commander loses the board to the next peer that commands after this silence, and a peer its place to
#: one that waits if it has not shown for so long that it receives states; heartbeats come at 1 Hz.
FREE_AFTER_S = 2.5


@dataclass(eq=False, slots=True)
class Peer:
    """A MAVLink system that sends to the board.

    Attributes:
        address: where it sends from, None on a stream.
        since_s: time of its first frame.
        heard_at_s: time of its last frame.
        refused_at_s: when it was last informed that another peer commands.
        present_at_s: when a heartbeat showed last that it receives the states of now.
        sequence: count of its frames and of lost ones.
    """

    address: Address
    system: int
    component: int
    since_s: float
    heard_at_s: float
    refused_at_s: float = float("-inf")
    present_at_s: float = float("-inf")
    sequence: SequenceCount = field(default_factory=SequenceCount)

    @property
    def place(self) -> tuple[Address, int, int]:
        """Address, system and component that it sends from."""
        return self.address, self.system, self.component

    @property
    def keeps_until_s(self) -> float:
        """Time until which it keeps its place although others wait."""
        return max(self.since_s + PROVE_S, self.present_at_s + FREE_AFTER_S)


class Peers:
    """Recently heard peers, the one that commands, or None, and frames without a place, `crowded_out`.

    Whoever commands or receives keeps its place: crowds of senders wait.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[Address, int, int], Peer] = {}
        self.commander: Peer | None = None
        self._lost_before = self._late_before = 0
        self.crowded_out = 0

    @property
    def lost(self) -> int:
        """Frames that never arrived."""
        return self._lost_before + sum(peer.sequence.lost for peer in self._known.values())

    @property
    def out_of_order(self) -> int:
        """Frames that arrived late or twice."""
        return self._late_before + sum(peer.sequence.out_of_order for peer in self._known.values())

    def addresses(self) -> list[Address]:
        """Addresses of all peers; None for a stream."""
        return list(dict.fromkeys(peer.address for peer in self._known.values()))

    def hear(self, address: Address, system: int, component: int, at_s: float) -> tuple[Peer | None, bool]:
        """Peer that sent a frame, None while it has to wait for a place; and whether it is new."""
        for peer in [peer for peer in self._others() if at_s - peer.heard_at_s > FORGET_AFTER_S]:
            self._drop(peer)
        place = address, system, component
        if (known := self._known.get(place)) is not None:
            known.heard_at_s = at_s
            return known, False
        if len(self._known) >= MOST_PEERS:
            least = min(self._others(), key=lambda peer: peer.keeps_until_s)
            if at_s <= least.keeps_until_s:
                self.crowded_out += 1
                return None, False
            self._drop(least)
        self._known[place] = Peer(address, system, component, at_s, at_s)
        return self._known[place], True

    def may_command(self, peer: Peer, at_s: float) -> bool:
        """Whether a peer commands, or may begin to because no other peer does."""
        holder = self.commander
        return holder is None or holder is peer or at_s - holder.heard_at_s > FREE_AFTER_S

    def farewell(self, peer: Peer) -> None:
        """Remove a peer that announces its end; the next one may command without waiting."""
        self._drop(peer)
        if peer is self.commander:
            self.commander = None

    def _others(self) -> list[Peer]:
        return [peer for peer in self._known.values() if peer is not self.commander]

    def _drop(self, peer: Peer) -> None:
        del self._known[peer.place]
        self._lost_before += peer.sequence.lost
        self._late_before += peer.sequence.out_of_order


#: Default time without the commander until the servos are released.
RELEASE_AFTER_S = 10.0

#: Periods of heartbeat and health, and of Euler angles for displays, in ticks.
BEAT_TICKS = 50
EULER_TICKS = 5

#: Minimum time between two refusals to one peer.
REFUSAL_PERIOD_S = 1.0

CRITICAL_SEVERITY, WARNING_SEVERITY = 2, 4


class ServoBoard(RunningBoard):
    """Moves servos as the frames on a MAVLink port command.

    Commands expire after `expiry_s`: then the pose is held until overrides come from a controller with
    current states, have come for `RESUME_AFTER_S`, or release the servos. After `release_after_s` without any
    frame of the commander the servos are released. The guard limits ranges and speeds and detects falls, as
    everywhere.
    """

    what = "board's port"

    #: Overrides: executed, refused (impossible pulse, stopped robot), of other peers, maybe older than a
    #: silence. Then poses held, and servos released.
    counted = ("overrides", "refused", "of_others", "not_yet", "expired", "released")

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
        own = mavlink_messages.BOARD_SYSTEM, mavlink_messages.BOARD_COMPONENT
        self._guard = Guard(servos, expiry_s=expiry_s)
        self._link = MavlinkLink(port, Codec(*own, signing_key=signing_key), time=servos.clock.time)
        super().__init__(self._guard, self._link)
        self._map = servo_map
        self._release_after_s = release_after_s
        self._channels = Channels(servo_map)
        self._expiry_s, self._overrides = expiry_s, OverrideStream(expiry_s)
        self._peers = Peers()
        self._stream = not port.datagrams
        self._commanded = False
        self._heard_at_s = 0.0

    def report(self) -> dict[str, Any]:
        """Counts so far, as JSON values."""
        return {
            **super().report(),
            "clipped": self._channels.clipped + self._guard.counters.clipped,
            "lost": self._peers.lost,
            "out_of_order": self._peers.out_of_order,
            "crowded_out": self._peers.crowded_out,
            "malformed": self._link.codec.malformed,
            "dropped": self._link.port.dropped,
            "overruns": self._guard.clock.overruns,
            "stopped": self._guard.stopped,
        }

    def _serve(self, timeout_s: float) -> None:
        arrivals = self._link.receive(timeout_s)
        if arrivals and self._commanded and arrivals[0][2] - self._overrides.at_s > self._expiry_s:
            self._read()  # this program may have stood still: what waited in the port is old
        for frame, sender, at_s in arrivals:
            self._handle(frame, sender, at_s)

    def _handle(self, frame: Frame, sender: Address, at_s: float) -> None:
        """Execute or answer one frame; no frame may end the loop."""
        peer, new = self._peers.hear(sender, frame.system, frame.component, at_s)
        if peer is None or not peer.sequence.in_order(frame.sequence, at_s):
            return
        if new:
            for message in self._introduction(self._guard.peek().measured):
                self._link.send(message, peer.address)
        if peer is self._peers.commander:
            self._heard_at_s = at_s
        if frame.kind == "RC_CHANNELS_OVERRIDE" and for_us(frame.message):
            self._override(frame.message, peer, at_s)
        elif frame.kind == "HEARTBEAT":
            if frame.message.system_status == mavlink_messages.POWEROFF:
                self._peers.farewell(peer)
            elif mavlink_messages.age_s(frame.message.custom_mode, at_s) <= self._expiry_s:
                peer.present_at_s = at_s
        else:
            for answer in answers(frame.kind, frame.message, peer.system, peer.component):
                self._link.send(answer, peer.address)

    def _override(self, message: Any, peer: Peer, at_s: float) -> None:
        if not self._peers.may_command(peer, at_s):
            self.counts["of_others"] += 1
            if at_s - peer.refused_at_s > REFUSAL_PERIOD_S:
                peer.refused_at_s = at_s
                words = "another controller holds the servos"
                self._link.send(board_messages.text(CRITICAL_SEVERITY, words), peer.address)
            return
        if peer is not self._peers.commander:
            self._peers.commander, self._overrides = peer, OverrideStream(self._expiry_s)
            if self._guard.stopped != "expired":
                # A new commander starts afresh: a fall or a fault under the one before does not count.
                self._guard.clear()
        self._heard_at_s = at_s
        raw = mavlink_messages.channels_of(message)
        if not self._counts(raw, peer, at_s):
            self.counts["not_yet"] += 1
            return
        try:
            self._channels.take(raw)
            self._move()
        except (CommandRefusedError, EStopError):
            self.counts["refused"] += 1
            return
        self.counts["overrides"] += 1

    def _counts(self, raw: list[int], peer: Peer, at_s: float) -> bool:
        """After a silence only a release, a present controller or a steady stream counts."""
        self._overrides.note(at_s)
        if self._guard.stopped != "expired":
            return True
        present = at_s - peer.present_at_s <= self._expiry_s
        if present or self._overrides.steady or self._channels.released_by(raw):
            self._guard.clear()
            return True
        return False

    def _move(self) -> None:
        """Write the channels' targets; released servos keep their last target."""
        channels = self._channels
        if not channels.active.any():
            self._release()
            return
        active = channels.active[self._map.channels - 1]
        wanted = self._map.to_rad(channels.pulses_us)
        wanted[~active] = self._guard.accepted_rad()[~active]
        self._guard.write(JointTargets(wanted, self._guard.clock.now_s))
        self._commanded = True

    def _release(self) -> None:
        self._channels.release()
        self._guard.disable_torque()
        self._guard.pause_watchdog()
        self.counts["released"] += 1
        self._commanded = False

    def _tick(self) -> None:
        state = self._read()
        if self._time.now() - self._heard_at_s > self._release_after_s:
            if self._commanded:
                self._release()
            self._peers.commander = None
        self._send_to_all(self._telemetry(state))

    def _read(self) -> RobotState:
        expired_before = self._guard.stopped == "expired"
        state = self._guard.read()
        self.counts["expired"] += not expired_before and self._guard.stopped == "expired"
        return state

    def _telemetry(self, state: RobotState) -> list[Any]:
        """Messages for a state, and periodically for the health of the board."""
        ticks, now_s = self.counts["ticks"], self._time.now()
        pulses = self._map.by_channel(self._map.raw(state.joint_positions_rad))
        sent = [board_messages.outputs(pulses, self._channels.active, now_s)]
        sent += board_messages.pose(state, now_s, with_euler=ticks % EULER_TICKS == 0)
        if state.foot_contacts is not None:
            sent.append(board_messages.contacts(state.foot_contacts, now_s))
        if ticks % BEAT_TICKS == 0:
            sent = [*self._introduction(state.measured), *sent]
            sent += board_messages.health(state, errors=self._link.codec.malformed)
        return sent

    def _introduction(self, measured: bool) -> list[Any]:
        sent = [
            board_messages.heartbeat(self._system_state()),
            board_messages.measured(measured, self._time.now()),
        ]
        if self._guard.stopped not in (None, "expired"):
            sent.append(board_messages.text(WARNING_SEVERITY, f"stopped: {self._guard.stopped}"))
        return sent

    def _system_state(self) -> int:
        if self._guard.stopped is not None:
            return int(mavlink_messages.CRITICAL)
        return int(mavlink_messages.ACTIVE if self._commanded else mavlink_messages.STANDBY)

    def _send_to_all(self, sent: list[Any]) -> None:
        """Send messages to all recently heard peers, or to a stream."""
        for address in [None] if self._stream else self._peers.addresses():
            for message in sent:
                self._link.send(message, address)
