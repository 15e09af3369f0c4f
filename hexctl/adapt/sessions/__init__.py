"""Sessions of adaptations: stored trials, lists and exports."""
