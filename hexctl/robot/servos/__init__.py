"""The servos of a robot: their drivers and models, and which of them moves which joint how."""
