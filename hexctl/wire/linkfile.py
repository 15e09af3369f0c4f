"""Link files: how to reach a robot, by name or path. Options given on the command line win."""

from pathlib import Path

from hexctl.wire.link import DEFAULT_ENDPOINT, Link


def load_link(
    name_or_path: str | None = None,
    *,
    endpoint: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
) -> Link:
    """Return the link of a file, or of the defaults, with the options given put in."""
    return Link(endpoint=endpoint or DEFAULT_ENDPOINT, credentials=credentials, insecure=insecure)
