"""Assessment of robots and gaits: loads, margins, speeds, causes of bad walks, uncertainty."""
