"""Monitor: detects failed legs in mid-walk from measurements."""
