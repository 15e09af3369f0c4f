"""Two PCA9685 boards on a simulated I2C bus, which move a simulated robot."""

import contextlib
import errno
import struct

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.i2c_socket import decode_transaction
from hexctl.robot.servos.pwm_map import PwmMap
from hexctl.simulators.board_faults import BoardFault
from hexctl.simulators.pca9685_chips import SimulatedI2c, SimulatedPca9685
from hexctl.simulators.simulated_board import SimulatedBoard, SocketLine
from hexctl.types import BoolArray, FloatArray, RobotState

#: Default speed of the bus in bits per second.
BITS_PER_S = 400_000

#: Bits on the wire of a byte, with its acknowledge.
BITS = 9

#: What each word of a fault takes.
PCA9685_FAULTS = {"nack": "[:SHARE]", "unplug": "", "replug": "", "reset": ""}


class Pca9685Board(SimulatedBoard):
    """Boards on a Unix socket, as there are no pseudo-devices for I2C.

    `servos` are unconnected, in real time; `bits_per_s` is the speed of the bus; `seed` draws failed
    transfers.
    """

    what, kinds, counted = "bus", PCA9685_FAULTS, ("transfers", "goals", "refused")

    def __init__(
        self,
        servos: LegServos,
        pwm_map: PwmMap,
        *,
        bits_per_s: int = BITS_PER_S,
        faults: tuple[BoardFault, ...] = (),
        seed: int = 0,
    ) -> None:
        self._line = SocketLine("i2c")
        super().__init__(servos, self._line, faults, seed)
        self._map, self._bits_per_s = pwm_map, bits_per_s
        self.chips = {
            address: SimulatedPca9685(oscillator_mhz)
            for address, oscillator_mhz in zip(pwm_map.addresses, pwm_map.oscillators_mhz, strict=True)
        }
        self._bus = SimulatedI2c(self.chips)
        self._nacks = 0.0

    def pulses_us(self) -> FloatArray:
        """Pulses of the joints, (18,); 0 for servos without."""
        outputs = np.concatenate([self.chips[address].pulses_us() for address in self._map.addresses])
        pulses: FloatArray = np.nan_to_num(outputs)[self._map.outputs]
        return pulses

    def _serve(self, timeout_s: float) -> None:
        for client, data in self._line.receive(timeout_s):
            with contextlib.suppress(OSError):  # a disconnected client misses its answer
                client.send(self._answer(data))

    def _answer(self, data: bytes) -> bytes:
        """Answer to a transaction: 0 and the bytes read, or an error number."""
        try:
            messages = decode_transaction(data)
        except struct.error:
            return bytes([errno.EINVAL])
        count = sum(1 + len(message.data) + message.reads for message in messages)
        self._time.sleep(BITS * count / self._bits_per_s)
        self.counts["transfers"] += 1
        if self._unplugged or self._random.random() < self._nacks:
            self.counts["refused"] += 1
            return bytes([errno.EREMOTEIO])
        try:
            answer = self._bus.transfer(messages)
        except OSError as error:
            self.counts["refused"] += 1
            return bytes([error.errno or errno.EIO])
        self.counts["goals"] += any(len(message.data) > 2 for message in messages)
        return b"\0" + answer

    def _begin(self, fault: BoardFault) -> None:
        if fault.kind == "nack":
            self._nacks = 1.0 if fault.value is None else fault.value
        else:  # reset
            for chip in self.chips.values():
                chip.reset()

    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        pulses = self.pulses_us()
        return pulses > 0, self._map.angles_rad(pulses)

    def _measure(self, state: RobotState) -> None:
        """Nothing is measured."""
