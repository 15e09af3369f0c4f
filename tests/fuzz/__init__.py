"""Hostile input for every decoder: `python -m tests.fuzz` searches, the tests run what it found again.

`rooms` has the targets, by what is decoded; `target` says what a target is, `engine` searches one of them,
and `corpus` keeps the inputs that reached something new (see README.md).
"""
