"""Servos with registers, Dynamixel and Feetech: registers, settings, one servo and a bus of them."""
