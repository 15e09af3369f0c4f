"""Finding a gait for a failed leg: the gait space, optimizers, the loop of trials, sessions."""
