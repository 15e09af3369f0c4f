"""The overview of a session as a recording: its values, its figures, and what the search expected."""
