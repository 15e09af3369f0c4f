"""Whether the code that a session names may be imported."""

from collections.abc import Collection

from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.errors import InputError, argument

#: Fields of a spec that may name code, with the argument that gives such a part instead.
_PARTS = {"optimizer": "optimizer", "objective": "objective", "backend": "servos", "policy": "policy"}

#: Begins names of the running script, which is loaded already.
_SCRIPT = "__main__:"


def foreign_parts(spec: SessionSpec) -> dict[str, str]:
    """Parts of a session that are code to be imported, `module:Name`, by their field of the spec."""
    named = {field: str(getattr(spec, field)) for field in _PARTS}
    return {field: name for field, name in named.items() if ":" in name and not name.startswith(_SCRIPT)}


def check_trusted(spec: SessionSpec, given: Collection[str], *, trust: bool) -> None:
    """Check that a session imports no code that nobody vouches for.

    Args:
        spec: of the session.
        given: arguments that the caller gives in place of what the spec names.
        trust: whether the caller vouches for the session.

    Raises InputError for a part that is named as `module:Name`.
    """
    for field, name in foreign_parts(spec).items():
        if not trust and _PARTS[field] not in given:
            raise InputError(
                f"session: its {field} is code to be imported, got {name!r}; allowed: names that hexctl "
                f"ships; if you trust the session and that module, add {argument('trust')}"
            )
