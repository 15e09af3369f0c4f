"""A camera that looks at a simulated robot: rendered pictures as a network camera sends them."""
