"""Landscapes of all gaits: simulated in chunks, and kept on disk for the code that made them."""
