"""LX-16A servos and their kin: packets, and a bus of them."""
