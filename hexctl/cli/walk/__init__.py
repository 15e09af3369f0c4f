"""Commands that walk a robot."""
