"""The controller, the guard, the 50 Hz loop and the trial, one at a time and in batches."""
