"""The robot description, and the two messages every part speaks."""
