"""Repertoires: building what walks that recover go by."""
