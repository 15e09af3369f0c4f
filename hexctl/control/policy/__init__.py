"""Trained policies: networks with a contract that says what they observe, and how they move the joints."""
