"""Link files: how to reach a robot, by name or path. What is given on the command line wins."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from hexctl.robot.configs import find_config, read_mapping, validate
from hexctl.wire.link import DEFAULT_ENDPOINT, Link


class LinkSchema(BaseModel):
    """What a link file may hold; every key may be left out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    endpoint: str = DEFAULT_ENDPOINT
    credentials: str | None = None
    insecure: Annotated[bool, Field(strict=True)] = False
    plain: Annotated[bool, Field(strict=True)] = False
    names: dict[str, str] = {}


def load_link(
    name_or_path: str | None = None,
    *,
    endpoint: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
) -> Link:
    """Return the link of a file, or the default one, with whatever else is given put in.

    A folder of credentials in a file is meant from where the file lies. Raises InputError that says file,
    key, value and what is allowed.
    """
    schema, folder = LinkSchema(), Path()
    if name_or_path is not None:
        path = find_config("links", name_or_path)
        schema, folder = validate(LinkSchema, read_mapping(path), path), path.parent
    if credentials is None and schema.credentials is not None:
        credentials = folder / Path(schema.credentials).expanduser()
    return Link(
        endpoint=endpoint or schema.endpoint,
        credentials=credentials,
        insecure=insecure or schema.insecure,
        names=schema.names,
        plain=schema.plain,
    )
