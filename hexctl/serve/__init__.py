"""Servers for any LegServos: a robot on the network with leases and stops, and a MAVLink servo board.

`hexctl.serve.service.serve(robot="ant")` serves a robot.
"""
