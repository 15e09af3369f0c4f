"""Servos on a half-duplex serial bus: the port, the packets, servo families, and the thread between them."""
