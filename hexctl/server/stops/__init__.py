"""A robot's side of stops: latched, kept on the disk, asked for by session or by datagram."""
