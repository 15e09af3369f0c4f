"""The simulated robot: MuJoCo through dm_control, one at a time or in batches."""
