"""Where commands keep what they make, below the folder that the user is in."""

from pathlib import Path

#: Recordings, sessions and studies.
RUNS = Path("runs")
