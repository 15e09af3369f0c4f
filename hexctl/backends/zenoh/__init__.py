"""A robot on the network as LegServos: its other end is `hexctl serve`."""
