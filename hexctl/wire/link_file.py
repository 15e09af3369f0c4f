"""Read link files: YAML that says where a robot is, its certificates and the names of its messages."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from hexctl.robot.configs import find_config, read_mapping, validate
from hexctl.wire.links import DEFAULT_ENDPOINT, Link


class LinkSchema(BaseModel):
    """Content of a link file; every key may be left out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    endpoint: str = DEFAULT_ENDPOINT
    credentials: str | None = None
    insecure: Annotated[bool, Field(strict=True)] = False
    plain: Annotated[bool, Field(strict=True)] = False
    names: dict[str, str] = {}


def read_link(name_or_path: str) -> Link:
    """Return the link of a file; a relative folder of credentials starts at the file's folder.

    Raises InputError that says file, key, value and what is allowed.
    """
    path = find_config("links", name_or_path)
    schema = validate(LinkSchema, read_mapping(path), path)
    credentials = None if schema.credentials is None else path.parent / Path(schema.credentials).expanduser()
    return Link(
        endpoint=schema.endpoint,
        credentials=credentials,
        insecure=schema.insecure,
        names=schema.names,
        plain=schema.plain,
    )
