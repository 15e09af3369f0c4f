"""Golden data: what hexctl did at a known commit, and the code that measures the same of today's."""
