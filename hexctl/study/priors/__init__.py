"""Building of priors from many simulated worlds."""
