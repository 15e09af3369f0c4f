"""I2C buses of tests, with the methods of smbus2 that are used."""

import errno
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hexctl.backends.pwm.i2c_socket import I2cMessage
from hexctl.simulators.pca9685_board import SimulatedI2c, SimulatedPca9685
from hexctl.types import FloatArray


@dataclass
class ChipBus:
    """Two simulated chips, and a log of what was transferred.

    Attributes:
        chips: by address.
        log: transactions, each a list of messages.
        fails: says of an address whether a transfer fails now.
        spoils: what becomes of a byte that was read.
    """

    chips: dict[int, SimulatedPca9685] = field(
        default_factory=lambda: {0x40: SimulatedPca9685(), 0x41: SimulatedPca9685()}
    )
    log: list[list[I2cMessage]] = field(default_factory=list)
    fails: Callable[[int], bool] = lambda _: False
    spoils: Callable[[int], Any] = lambda value: value
    lock: threading.Lock = field(default_factory=threading.Lock)

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self._transfer([I2cMessage(address, data=bytes([register, value]))])

    def read_byte_data(self, address: int, register: int) -> int:
        read = self._transfer([I2cMessage(address, data=bytes([register])), I2cMessage(address, 1)])
        value: int = self.spoils(read[0])
        return value

    def i2c_rdwr(self, *messages: Any) -> None:
        self._transfer([I2cMessage(message.addr, data=bytes(message)) for message in messages])

    def close(self) -> None:
        """The chips stay."""

    def pulses_us(self) -> FloatArray:
        """Pulses that come out, (32,), of the chips in the order of their addresses."""
        with self.lock:
            return np.concatenate([self.chips[address].pulses_us() for address in sorted(self.chips)])

    def writes(self) -> list[tuple[int, bytes]]:
        """Addresses and bytes of messages that wrote more than the register of a question."""
        with self.lock:
            messages = [message for transaction in self.log for message in transaction]
        return [(message.address, message.data) for message in messages if len(message.data) > 1]

    def _transfer(self, messages: list[I2cMessage]) -> bytes:
        with self.lock:
            self.log.append(messages)
            if self.fails(messages[0].address):
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            return SimulatedI2c(self.chips).transfer(messages)


class FlatBus:
    """Two arrays of bytes that keep what is written, and know nothing of any chip."""

    def __init__(self) -> None:
        self.memories = {0x40: bytearray(256), 0x41: bytearray(256)}

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self.memories[address][register] = value

    def read_byte_data(self, address: int, register: int) -> int:
        return self.memories[address][register]

    def i2c_rdwr(self, *messages: Any) -> None:
        for message in messages:
            register, *data = list(message)
            self.memories[message.addr][register : register + len(data)] = bytes(data)

    def close(self) -> None:
        """The bytes stay."""
