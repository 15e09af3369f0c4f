"""Where the robot is now, from sightings that come late and from its own motion."""
