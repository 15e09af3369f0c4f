"""What travels over Zenoh: keys, payloads, protocol version, and the sessions that carry them."""
