"""A camera over the floor, and tags on robot and floor: where the robot is."""
