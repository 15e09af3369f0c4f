"""Rerun recordings of trials: write them, lay them out, open them."""
