"""A robot in the browser, in 3D: a simulated one to play with, and a read-only view of a real one."""
