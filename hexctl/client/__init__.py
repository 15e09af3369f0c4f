"""Clients of robots on the network that do not command them: stop, clear, status, failures."""
