"""The overview recording of a session: all its trials in one picture, one curve and one table."""
