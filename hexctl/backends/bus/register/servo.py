"""One servo with registers on a line, Dynamixel or Feetech: its memory, read and written by id."""

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PING, READ, REBOOT, WRITE
from hexctl.backends.bus.register.registers import Register, RegisterTable
from hexctl.backends.bus.servo_bus import TRIES

#: What is said of a servo that does not answer.
SILENT = "no answer"


def place(protocol: int, address: int, size: int) -> bytes:
    """Parameters that name some bytes of the memory, in a protocol's width: 1 byte a number, or 2."""
    return address.to_bytes(protocol, "little") + size.to_bytes(protocol, "little")


class RegisterServo:
    """Memory of one servo. Its methods raise OSError when the port has gone.

    Args:
        packets: of the servo's protocol, on an open line.
        table: registers of its model.
        servo_id: that it answers to.
    """

    def __init__(self, packets: PacketLine, table: RegisterTable, servo_id: int) -> None:
        self._packets, self.table, self.servo_id = packets, table, servo_id

    def answers(self, *, tries: int = TRIES) -> bool:
        """Whether it answers a ping."""
        return self._packets.ask(self.servo_id, PING, tries=tries) is not None

    def raw(self, register: Register | None, *, tries: int = TRIES) -> int | None:
        """Raw number in a register; None without an answer, and for no register."""
        if register is None:
            return None
        asked = place(self.table.protocol, register.address, register.size)
        for _ in range(tries):
            answer = self._packets.ask(self.servo_id, READ, asked)
            if answer is not None and len(answer.parameters) == register.size:
                return int.from_bytes(answer.parameters, self.table.byte_order)
            if tries > 1:
                self._packets.outwait()
        return None

    def sure(self, register: Register | None) -> int | None:
        """Raw number that was read twice in a row, for what is decided by it; None where that does not come.

        An answer says neither its address nor its question: one that is late passes for another.
        """
        before = self.raw(register)
        for _ in range(TRIES):
            if before is None:
                return None
            again = self.raw(register)
            if again == before:
                return again
            self._packets.outwait()
            before = again
        return None

    def value(self, register: Register | None, *, tries: int = TRIES) -> float | None:
        """Number in a register in its unit; None without an answer, and for no register."""
        raw = self.raw(register, tries=tries)
        return None if raw is None or register is None else register.value(raw)

    def sure_value(self, register: Register | None) -> float | None:
        """Number in its unit that was read twice in a row, as `sure`."""
        raw = self.sure(register)
        return None if raw is None or register is None else register.value(raw)

    def report(self) -> tuple[bytes, str] | None:
        """Bytes of a report, and what the servo complains of; None without an answer."""
        asked = place(self.table.protocol, *self.table.block)
        for _ in range(TRIES):
            answer = self._packets.ask(self.servo_id, READ, asked)
            if answer is not None and len(answer.parameters) == self.table.block[1]:
                return answer.parameters, self.table.complaint(answer.error)
        return None

    def write(self, register: Register, value: float, *, tries: int = TRIES) -> str:
        """Write a number in its unit; empty where the servo took it, else why it did not.

        An instruction that arrived damaged is sent again; what a servo refuses is not.
        """
        data = register.address.to_bytes(self.table.protocol, "little") + self.table.packed(register, value)
        said = SILENT
        for _ in range(tries):
            answer = self._packets.ask(self.servo_id, WRITE, data)
            said = SILENT if answer is None else self.table.refusal(answer.error)
            if answer is None:
                self._packets.outwait()
            if said not in (SILENT, "CRC", "checksum"):
                break
        return said

    def change(self, register: Register, value: float) -> str:
        """Write a number where it is another, and read it back; empty where it is as wanted, else why not.

        Some servos drop what they do not take without a word, and some answers are lost.
        """
        if self.sure(register) == register.raw(value):
            return ""
        said = self.write(register, value)
        after = self.sure(register)
        if after == register.raw(value):
            return ""
        return said or (SILENT if after is None else f"it keeps {after}")

    def reboot(self) -> None:
        """Let it start again, without torque; protocol 2 only."""
        self._packets.ask(self.servo_id, REBOOT)
