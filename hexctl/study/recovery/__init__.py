"""Recovery measured: legs and joints fail in mid-walk, and methods are compared by what follows."""
