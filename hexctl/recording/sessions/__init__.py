"""The overview of a session as a recording: its values, its figures, and the expectations of the search."""
