"""MAVLink 2: the wire to a servo board, used by both ends."""
