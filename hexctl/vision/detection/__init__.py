"""Detect tags in a picture, and locate them with the lens and the pose of the camera."""
