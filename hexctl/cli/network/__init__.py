"""Commands about robots on the network."""
