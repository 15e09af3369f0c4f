"""How well adaptation does in worlds that nobody has simulated before."""
