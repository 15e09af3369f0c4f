"""Kinematics of the legs, and the support polygon."""
