"""The fault matrix: what a robot does when something fails, and how fast: faults, backends, phases."""
