"""Commands about robots on the network, their cameras, and simulated ones."""
