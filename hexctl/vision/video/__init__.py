"""Videos in and out: cameras, network streams, files."""
