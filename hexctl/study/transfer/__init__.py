"""Transfer benchmark: adaptation in worlds outside every prior."""
