"""The paper's claims in this simulation: evidence, rules and verdicts, under one reading or many."""
