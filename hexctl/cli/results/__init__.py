"""Commands that show, list and export what was recorded."""
