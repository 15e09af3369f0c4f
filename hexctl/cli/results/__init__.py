"""Commands that show, list and export recordings and sessions."""
