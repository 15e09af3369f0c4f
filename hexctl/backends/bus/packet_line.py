"""A line on which servos answer packets, one question at a time."""

from collections.abc import Callable, Collection
from dataclasses import dataclass

from hexctl.backends.bus.packets import PacketFormat, PacketStream, StatusPacket
from hexctl.backends.bus.serial_line import UNUSED_ID, SerialLine

#: Least and first time for an answer besides its time on the wire.
#:
#: FTDI adapters may deliver 16 ms late.
LEAST_TIMEOUT_S, FIRST_TIMEOUT_S = 0.004, 0.034

#: How many times the delay of the answers so far is waited for, and the share of each answer in that.
TIMEOUT_TIMES, TIMEOUT_SHARE = 4.0, 0.1

#: Maximum delay of an abandoned answer, in longest timeouts.
LATEST_TIMES = 2.0

#: Parameters of most answers at the most.
ANSWER_BYTES = 24


@dataclass(frozen=True, slots=True)
class _Missed:
    """A request without an answer in time: its parameters, and until when the answer may still come."""

    request: bytes
    size: int | None
    deadline_s: float


class PacketLine:
    """Packets of one protocol on an open line. Its methods raise OSError when the port is lost.

    `timeout_s` is the time for an answer besides its time on the wire; with `adapts` it follows the last
    delays. `late` counts what came when no answer was missing, `absent` answers of a board in place of a
    servo. `on_report` gets what a board sends by itself.
    """

    def __init__(
        self,
        line: SerialLine,
        packets: PacketFormat,
        *,
        timeout_s: float = FIRST_TIMEOUT_S,
        adapts: bool = True,
    ) -> None:
        self.line, self.packets = line, packets
        self._stream = PacketStream(self.packets)
        self.timeout_s = self._most_timeout_s = timeout_s
        self._adapts, self.late, self.absent = adapts, 0, 0
        self._missed: dict[int, _Missed] = {}
        self.on_report: Callable[[StatusPacket], None] = lambda _: None

    @property
    def garbled(self) -> int:
        """Bytes so far that belonged to no packet."""
        return self._stream.garbled

    def tell(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        """Send a packet that no servo answers."""
        self.line.write(self.packets.instruction(servo_id, instruction, parameters))

    def ask(
        self, servo_id: int, instruction: int, parameters: bytes = b"", *, tries: int = 1
    ) -> StatusPacket | None:
        """Answer of one servo; None without one in some tries.

        Most answers do not name their question: it waits while a missed answer of equal length may come.
        """
        request = self.packets.instruction(servo_id, instruction, parameters)
        size = self.packets.answer_size(instruction, parameters)
        room = size if size is not None and self.packets.names_question else max(ANSWER_BYTES, size or 0)
        wire_s = self.line.wire_s(len(request) + self.packets.status_size(room))
        self._wait_for_late(servo_id, request, size)
        for attempt in range(tries):
            late_deadline_s = self.line.time.now() + wire_s + LATEST_TIMES * self._most_timeout_s
            answers = self.transact(request, (servo_id,), wire_s)
            fitting = [each for each in answers if size in (None, len(each.parameters)) or each.error]
            if attempt or not fitting:
                self._missed[servo_id] = _Missed(request, size, late_deadline_s)
            self.late += len(answers) - len(fitting)
            if fitting:
                return fitting[0]
        return None

    def ping(self, servo_id: int, *, tries: int = 1) -> bool:
        """Whether a servo answers a ping."""
        return self.ask(servo_id, self.packets.probe, tries=tries) is not None

    def hear(self, servo_id: int) -> tuple[int, int]:
        """Ping a servo and listen until the timeout: several may answer, one after the other.

        Returns the number of complete answers of the servo, and of bytes outside packets.
        """
        line, before = self.line, self.garbled
        request = self.packets.instruction(servo_id, self.packets.probe)
        self.discard()
        line.write(request)
        deadline_s = line.time.now() + line.wire_s(len(request) + self.packets.status_size(ANSWER_BYTES))
        deadline_s += self.timeout_s
        came: list[StatusPacket] = []
        while line.time.now() < deadline_s:
            came += self._asked_for(self._stream.feed(line.read(deadline_s)))
        came += self._asked_for(self._stream.finish())
        answers = [
            each.servo_id == servo_id
            and self.packets.answers(request, each)
            and not self.packets.absent(each)
            for each in came
        ]
        return sum(answers), self.garbled - before

    def discard(self) -> bool:
        """Drop what has come except reports; whether there was any."""
        if not self.packets.reports:
            came = self.line.discard()
            self._stream.finish()
            return came
        dropped = []
        while data := self.line.read(0.0):  # the rest of a report may still be on its way
            dropped += self._asked_for(self._stream.feed(data))
        return bool(dropped)

    def hears_noise(self, deadline_s: float) -> bool:
        """Whether bytes come until a time that belong to no report."""
        before = self.garbled
        while self.line.time.now() < deadline_s and self.garbled == before:
            data = self.line.read(deadline_s)
            if data and (not self.packets.reports or self._asked_for(self._stream.feed(data))):
                return True
        return self.garbled > before

    def _asked_for(self, came: list[StatusPacket]) -> list[StatusPacket]:
        """Packets without the reports, which are passed on."""
        if not self.packets.reports:
            return came
        for packet in came:
            if self.packets.is_report(packet):
                self.on_report(packet)
        return [packet for packet in came if not self.packets.is_report(packet)]

    def _wait_for_late(self, servo_id: int, request: bytes, size: int | None) -> None:
        """Discard an answer that could be mistaken for the one to another request."""
        missed = self._missed.get(servo_id)
        if missed is None or missed.request == request or self.packets.names_question:
            return
        if None not in (size, missed.size) and size != missed.size:
            return
        while self.line.time.now() < missed.deadline_s:
            self.line.read(missed.deadline_s)
        del self._missed[servo_id]

    def transact(self, request: bytes, asked: Collection[int], wire_s: float) -> list[StatusPacket]:
        """Answers of the `asked` ids to a packet; `wire_s` is the time of all of them on the wire."""
        line, stream = self.line, self._stream
        if self.discard():  # too late for the packet before
            self._note_late()
        # Moves of LX-16A servos fill the line for milliseconds; shorter packets are in the learned delay.
        free_s = line.free_s if self.packets.names_question else 0.0
        begin_s = answered_s = max(self.line.time.now(), free_s)
        line.write(request)
        answers: dict[int, StatusPacket] = {}
        absent: set[int] = set()
        deadline_s = begin_s + wire_s + self.timeout_s
        while len(answers) + len(absent) < len(asked):
            data = line.read(deadline_s)
            came = stream.feed(data)
            over = not data and self.line.time.now() >= deadline_s
            for answer in self._asked_for(came + stream.finish() if over else came):
                if answer.servo_id in asked and self.packets.answers(request, answer):
                    if self.packets.absent(answer):
                        absent.add(answer.servo_id)
                        self.absent += 1
                        continue
                    self.late += answer.servo_id in answers
                    answers[answer.servo_id], answered_s = answer, self.line.time.now()
                else:  # too late for the packet before
                    self._note_late()
            if over:
                break
        if not answers and len(asked) > 1:  # as if there were none: they may all be late
            self._wait_longer()
        # Learned from the last received answer: missing servos are not waited for any longer.
        if self._adapts and answers:
            delay_s = max(TIMEOUT_TIMES * (answered_s - begin_s - wire_s), LEAST_TIMEOUT_S)
            if self.packets.names_question:  # a late answer cannot be mistaken for another
                delay_s = min(delay_s, self._most_timeout_s)
            self.timeout_s += TIMEOUT_SHARE * (delay_s - self.timeout_s)
            self.timeout_s = min(self.timeout_s, self._most_timeout_s)
        return list(answers.values())

    def _note_late(self) -> None:
        self.late += 1
        self._wait_longer()

    def _wait_longer(self) -> None:
        self.timeout_s = min(2 * self.timeout_s, self._most_timeout_s)

    def outwait(self) -> None:
        """Drop a late answer, unless it names its question."""
        if self.packets.names_question:
            return
        deadline_s = self.line.time.now() + self._most_timeout_s
        while self.line.time.now() < deadline_s:
            self.line.read(deadline_s)
        self._stream.finish()

    def learn_echo(self) -> None:
        """Ping an unused id to learn whether the adapter echoes; a board with reports does not."""
        if self.packets.reports:
            return
        self.line.learn_echo(self.packets.instruction(UNUSED_ID, self.packets.probe), FIRST_TIMEOUT_S)
