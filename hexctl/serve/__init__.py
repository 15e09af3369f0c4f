"""Servers for any LegServos: a robot on the network with leases and stops, and a MAVLink servo board.

`hexctl.serve(robot="ant")` serves a robot, the modules here are its parts.

Its parameters: `help(hexctl.serve.__call__)`.
"""

from hexctl.callable_package import make_callable

make_callable(__name__, "service")
