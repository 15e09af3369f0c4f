"""Names of servo drivers in robot files, commands and backends."""

from typing import Literal, get_args

#: Servos on a bus, whose positions are counts.
BusDriver = Literal["dynamixel", "feetech", "lx16a"]

#: Boards that make the pulses of hobby servos.
PwmDriver = Literal["servo2040", "pca9685"]

Driver = Literal[BusDriver, PwmDriver]

BUS_DRIVERS: tuple[BusDriver, ...] = get_args(BusDriver)
PWM_DRIVERS: tuple[PwmDriver, ...] = get_args(PwmDriver)
