"""Finding a gait for a failed leg: `hexctl.adapt(failed_leg=5)` searches, the modules here are its parts.

The package can be called: `hexctl.adapt(...)` is `hexctl.adapt.adaptation.adapt(...)`, which is imported at
the first call, so that importing a part stays cheap.
"""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hexctl.adapt.adaptation import AdaptationResult


class _CallablePackage(ModuleType):
    """This package as a function."""

    def __call__(self, *args: Any, **options: Any) -> "AdaptationResult":
        """Find a gait for a failed leg; arguments and errors as of `hexctl.adapt.adaptation.adapt`."""
        from hexctl.adapt.adaptation import adapt

        return adapt(*args, **options)


sys.modules[__name__].__class__ = _CallablePackage
