"""Holds compared: where walks in unseen worlds end open loop, with the yaw, and with the pose."""
