"""Robots in the formats of other programs: URDF and MJCF."""
