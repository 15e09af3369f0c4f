"""The pictures of the documentation, made anew: `python -m pictures`."""
