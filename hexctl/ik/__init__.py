"""Closed-form kinematics of all six legs at once, both ways."""
