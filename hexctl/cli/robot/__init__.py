"""Commands about a robot file, and what there is to choose from."""
