"""Drive a simulated robot with a gamepad: hold a shoulder button, push the left stick; start ends it."""

import os
import struct
import sys

from hexctl import Drive

EVENT = struct.Struct("llHHi")  # seconds, microseconds, type, code, value: see linux/input.h
KEY, AXIS = 1, 3
STICK_X, STICK_Y, SHOULDER, START = (AXIS, 0), (AXIS, 1), (KEY, 310), (KEY, 315)

if len(sys.argv) != 2:
    raise SystemExit("usage: python examples/gamepad.py /dev/input/eventN; ls /dev/input/by-id names them")
pad = os.open(sys.argv[1], os.O_RDONLY | os.O_NONBLOCK)
values = dict.fromkeys((STICK_X, STICK_Y, SHOULDER, START), 0)
with Drive("ant", realtime=True) as robot:
    while not values[START]:
        try:
            while data := os.read(pad, EVENT.size):
                _, _, kind, code, value = EVENT.unpack(data)
                values[kind, code] = value
        except BlockingIOError:  # no more events
            pass
        held = bool(values[SHOULDER])
        speed = robot.share(-held * values[STICK_Y] / 32768, -held * values[STICK_X] / 32768, 0)
        robot.command(speed.forward_m_s, speed.left_m_s)
        state = robot.step()
print(f"walked {state.base_position_world[0]:.2f} m forward")
