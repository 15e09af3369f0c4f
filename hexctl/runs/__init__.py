"""Runs: their options, a walk from start to result, and a diagnosis at rest."""
