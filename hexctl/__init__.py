"""hexctl walks a simulated or a real six-legged robot at 50 Hz."""
