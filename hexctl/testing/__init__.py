"""Conformance suites for custom servos, families of bus servos and optimizers; run by pytest.

```python
from hexctl.testing import LegServosConformance

class TestMyServos(LegServosConformance):
    def make(self):
        return MyServos(hexctl.load_robot("ant"))
```
"""

from hexctl.errors import MissingExtraError

try:
    import pytest
except ModuleNotFoundError as error:
    raise MissingExtraError("hexctl.testing", "testing") from error

# Before the import of the suites: a failed comparison then shows both of its sides.
pytest.register_assert_rewrite(
    *(f"hexctl.testing.{kind}_conformance" for kind in ("servo", "family", "optimizer"))
)

from hexctl.testing.family_conformance import BusFamilyConformance  # noqa: E402
from hexctl.testing.optimizer_conformance import OptimizerConformance  # noqa: E402
from hexctl.testing.servo_conformance import LegServosConformance  # noqa: E402

__all__ = ["BusFamilyConformance", "LegServosConformance", "OptimizerConformance"]
