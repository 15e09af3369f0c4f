"""Server side of stops: latched, stored on the disk, requested by session or by datagram."""
