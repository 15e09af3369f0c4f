"""The pictures of the documentation: `python -m pictures` makes them."""
