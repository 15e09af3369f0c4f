"""Hostile input for every decoder: `python -m tests.fuzz` searches, the tests run what it found again.

`rooms` has the targets, by what is decoded; `target` says what a target is, `engine` searches one of them,
`corpus` keeps the inputs that reached something new, and `table` says how many there were (see README.md).
"""
