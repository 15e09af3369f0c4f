"""A protocol of bus servos in a package of its own: the commands of an LX-16A, framed by an invented maker.

Packets begin with AC E5 and end with a CRC-8 in place of a sum. Once it is installed, `acme` is a driver:

pip install ./bus_family
hexctl servos scan --driver acme --port /dev/ttyUSB0
hexctl sim board --bus acme
"""

from dataclasses import replace

import fastcrc

from hexctl.backends.bus.families import lx16a
from hexctl.backends.bus.packets import SumPackets
from hexctl.backends.bus.servo_type import ServoType

PACKETS = SumPackets(
    b"\xac\xe5",
    counted=3,
    most_parameters=4,
    answers=lx16a.ANSWER_BYTES,
    probe=lx16a.READ_POSITION,
    checksum=fastcrc.crc8.smbus,
)

ACME = replace(
    lx16a.LX16A,
    name="acme",
    models=(ServoType("acme-200", None, 6.0, counts=1000 * 360 / 200, most=1000, centre=500),),
    bauds=(250_000, 115_200),
    formats={1: PACKETS},
)
