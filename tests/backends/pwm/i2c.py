"""I2C buses of tests, with the methods of smbus2 that are used."""

import errno
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from smbus2 import i2c_msg

from hexctl.backends.pwm.i2c_socket import I2cMessage, I2cSocket
from hexctl.backends.pwm.pca9685 import I2cBus
from hexctl.simulators.pca9685_board import SimulatedI2c, SimulatedPca9685
from hexctl.types import FloatArray


def byte_of(bus: I2cBus, address: int, register: int) -> int:
    """The byte of a register."""
    answer = i2c_msg.read(address, 1)
    bus.i2c_rdwr(i2c_msg.write(address, [register]), answer)
    return bytes(answer)[0]


@dataclass
class ChipBus(I2cSocket):
    """Two simulated chips.

    Attributes:
        chips: by address.
        fails: says of an address whether a transfer fails now.
        spoils: what becomes of a byte that was read.
    """

    chips: dict[int, SimulatedPca9685] = field(
        default_factory=lambda: {0x40: SimulatedPca9685(), 0x41: SimulatedPca9685()}
    )
    fails: Callable[[int], bool] = lambda _: False
    spoils: Callable[[int], int] = lambda value: value
    lock: threading.Lock = field(default_factory=threading.Lock)

    def close(self) -> None:
        """The chips stay."""

    def pulses_us(self) -> FloatArray:
        """Pulses that come out, (32,), of the chips in the order of their addresses."""
        with self.lock:
            return np.concatenate([self.chips[address].pulses_us() for address in sorted(self.chips)])

    def _transfer(self, messages: Sequence[I2cMessage]) -> bytes:
        with self.lock:
            if self.fails(messages[0].address):
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            return bytes(map(self.spoils, SimulatedI2c(self.chips).transfer(list(messages))))


class FlatBus(I2cSocket):
    """Two arrays of bytes that keep what is written, and know nothing of any chip."""

    def __init__(self) -> None:
        self.memories = {0x40: bytearray(256), 0x41: bytearray(256)}

    def close(self) -> None:
        """The bytes stay."""

    def _transfer(self, messages: Sequence[I2cMessage]) -> bytes:
        register, *data = messages[0].data
        memory = self.memories[messages[0].address]
        memory[register : register + len(data)] = bytes(data)
        return bytes(memory[register : register + messages[-1].reads])
