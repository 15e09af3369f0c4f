"""`hexctl see`: one file per command, and common options."""
