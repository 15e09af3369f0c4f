"""The paper's experiments: landscapes of all gaits, convergence of all optimizers, one report."""
