"""Choice of gaits: stability, crawls, top speed, speeds by direction, legs that may be lost."""
