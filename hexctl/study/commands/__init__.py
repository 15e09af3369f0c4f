"""Commands with long simulations."""
