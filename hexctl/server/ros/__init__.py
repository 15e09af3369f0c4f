"""A served robot in ROS 2: publishers, subscriptions and services."""
