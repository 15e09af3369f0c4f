"""Options that several commands share, each defined once: its name, help, range, completion and check.

Light to import: `hexctl --help` needs only these.
"""
