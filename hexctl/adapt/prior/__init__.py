"""What simulations of many plausible worlds say before the first trial, and what trials then tell."""
