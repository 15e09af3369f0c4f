"""Import of robot descriptions: URDF and MJCF of other tools become robot files."""
