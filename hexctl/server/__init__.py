"""A server for any LegServos: a robot on the network with leases and stops (`service.serve`)."""
