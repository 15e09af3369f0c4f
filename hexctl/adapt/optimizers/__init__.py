"""The optimizers that come with hexctl, and how one is found by its name."""
