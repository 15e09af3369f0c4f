"""Servo calibration: sign, offset and limits of each servo, with an operator at the robot."""
