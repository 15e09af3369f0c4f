"""Hostile input for every decoder: `python -m tests.fuzz` searches, the tests run what it found again.

`rooms` lists the modules with targets, `target` says what a target is, `engine` searches one of them, and
`corpus` keeps the inputs that reached something new.
"""
