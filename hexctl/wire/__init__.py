"""Wire protocol over Zenoh: links, sessions, certificates, messages, and the constants of both ends."""

#: Changes whenever an older peer would misunderstand a newer one.
PROTOCOL_VERSION = 1

#: Longest message of a robot; longer ones are dropped unread.
MAX_PAYLOAD_BYTES = 65_536

#: Validity of a command, and the longest silence after which a robot keeps moving.
TIME_TO_LIVE_S = 0.2
