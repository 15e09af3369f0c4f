"""What robots and gaits are capable of: loads, margins and speeds, causes of bad walks, uncertainty."""
