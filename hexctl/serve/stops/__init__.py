"""Stops of a robot that stay: each has an id, is kept on the disk, and comes by session or by datagram."""
