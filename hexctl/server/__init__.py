"""A server for any LegServos: a robot on the network with leases and stops.

`hexctl.server.service.serve(robot="ant")` serves a robot.
"""
