"""A served robot in ROS 2: what it publishes there, and what it takes from there."""
