"""Which leg has failed, noticed in mid-walk from what the robot measures."""
