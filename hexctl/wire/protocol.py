"""The version of what hexctl says over Zenoh, and the bounds that both ends keep."""

#: Changes whenever an older peer would misunderstand a newer one.
PROTOCOL_VERSION = 1

#: No message of a robot is longer; longer ones are dropped unread.
MAX_PAYLOAD_BYTES = 65_536

#: How long a command is good for, and the longest silence in which a robot goes on.
TIME_TO_LIVE_S = 0.2
