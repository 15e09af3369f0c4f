"""Driving: velocity commands from several sources, and the walk that follows them."""
