"""Servo calibration: sign, offset and limits of each servo, with an operator at the robot."""

from hexctl.control.calibration.operator import CalibrationResult, EndedError, Operator
from hexctl.control.calibration.servo_calibration import calibrate, chosen_joints

__all__ = ["CalibrationResult", "EndedError", "Operator", "calibrate", "chosen_joints"]
