"""Sessions of adaptations: their trials, kept on disk row by row, read back, listed and exported."""
