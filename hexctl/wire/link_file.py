"""Reads link files: YAML with a robot's endpoint, certificates and message names."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from hexctl.robot.configs import find_config, read_mapping, validate


class LinkSchema(BaseModel):
    """Content of a link file; every key is optional."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    endpoint: str = ""
    credentials: str | None = None
    insecure: Annotated[bool, Field(strict=True)] = False
    plain: Annotated[bool, Field(strict=True)] = False
    names: dict[str, str] = {}


def read_link_file(name_or_path: str) -> dict[str, Any]:
    """The `Link` fields of a file; relative credentials start at its folder.

    Raises InputError for a missing file and an invalid key or value.
    """
    path = find_config("links", name_or_path)
    said = validate(LinkSchema, read_mapping(path), path).model_dump(exclude_unset=True)
    if said.get("credentials") is not None:
        said["credentials"] = path.parent / Path(said["credentials"]).expanduser()
    return said
