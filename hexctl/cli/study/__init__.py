"""Commands that simulate a lot."""
