"""Clients that supervise robots on the network without commanding them: stop, clear, status, failures."""
