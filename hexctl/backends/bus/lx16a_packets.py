"""Commands of LewanSoul (Hiwonder) bus servos: LX-16A, LX-224, HTS-35H.

Numbers are little-endian. Writes are not answered; an answer repeats its command, which has no parameters
(LewanSoul Bus Servo Communication Protocol).
"""

from hexctl.backends.bus.packets import SumPackets

#: Commands that write.
MOVE, WRITE_ID, WRITE_LIMITS, WRITE_MODE, WRITE_LOAD = 1, 13, 20, 29, 31

#: Parameters of each command that writes.
WRITE_BYTES = {MOVE: 4, WRITE_ID: 1, WRITE_LIMITS: 4, WRITE_MODE: 4, WRITE_LOAD: 1}

#: Commands that ask.
READ_ID, READ_LIMITS, READ_VOLTAGE_LIMITS, READ_MOST_TEMPERATURE = 14, 21, 23, 25
READ_TEMPERATURE, READ_VOLTAGE, READ_POSITION, READ_MODE, READ_LOAD = 26, 27, 28, 30, 32

#: Parameters in the answer to each command that asks.
ANSWER_BYTES = {
    READ_ID: 1,
    READ_LIMITS: 4,
    READ_VOLTAGE_LIMITS: 4,
    READ_MOST_TEMPERATURE: 1,
    READ_TEMPERATURE: 1,
    READ_VOLTAGE: 2,
    READ_POSITION: 2,
    READ_MODE: 4,
    READ_LOAD: 1,
}

#: Longest time of a move, in ms.
MOST_MOVE_MS = 30_000

#: The one format of the family: an answer has the command that it answers in place of an error.
LX16A = SumPackets(b"\x55\x55", counted=3, most_parameters=4, most_id=0xFF, answers=ANSWER_BYTES)
LX16A.probe = READ_POSITION


def move(servo_id: int, count: int, time_ms: int) -> bytes:
    """Packet that moves a servo to a count, 0 to 1000, in a time in ms."""
    time_ms = min(max(time_ms, 0), MOST_MOVE_MS)
    return LX16A.instruction(servo_id, MOVE, count.to_bytes(2, "little") + time_ms.to_bytes(2, "little"))


def load(servo_id: int, *, on: bool) -> bytes:
    """Packet that switches the torque of a servo."""
    return LX16A.instruction(servo_id, WRITE_LOAD, bytes([on]))


def mode(servo_id: int, *, motor: bool) -> bytes:
    """Packet that selects position mode, or motor mode at speed 0."""
    return LX16A.instruction(servo_id, WRITE_MODE, bytes([motor, 0, 0, 0]))


def number(parameters: bytes) -> int:
    """Number in the parameters of an answer; two bytes are signed."""
    return int.from_bytes(parameters, "little", signed=len(parameters) == 2)
