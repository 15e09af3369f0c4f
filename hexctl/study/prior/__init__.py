"""Build priors: walk all gaits in many plausible worlds, and keep what became of them."""
