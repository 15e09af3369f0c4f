"""The servo board: a MAVLink peer with a simulated robot, and the reference for those who write firmware."""
