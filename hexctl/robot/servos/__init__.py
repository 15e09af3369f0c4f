"""The servos of a robot: drivers, models, and the maps from joints to servos."""
