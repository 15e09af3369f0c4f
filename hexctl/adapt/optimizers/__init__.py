"""The shipped optimizers, and their registry."""
