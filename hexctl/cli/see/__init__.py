"""`hexctl see`: one file per command, and the options that several of them have."""
