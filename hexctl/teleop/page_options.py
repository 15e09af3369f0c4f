"""Options of a page that moves a robot, and the certificates that it is served with."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from hexctl.control.calibration.servo_calibration import CalibrationOptions
from hexctl.errors import InputError, argument
from hexctl.options import RARE, check_fields, flag_name

if TYPE_CHECKING:
    from hexctl.wire.certificates import Credentials


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Where a page is served."""

    PANEL: ClassVar = "Page"

    page: str | None = None
    """Serve a page at HOST:PORT, such as 127.0.0.1:8017 for this computer only; beyond it --page-keys are
    needed, and the token that is printed. (default: none)
    """

    page_keys: Annotated[Path | None, RARE] = None
    """Folder of certificates that hexctl keys new made, for a page beyond this computer. (default: none)"""

    def check_page(self) -> None:
        """Raise InputError for an address that cannot be served, or keys without a page."""
        if self.page is not None:
            from hexctl.wire.page_address import PageAddress

            PageAddress.parse(self.page).check(secured=self.page_keys is not None)
        elif self.page_keys is not None:
            raise InputError(f"{argument('page_keys')}: used without --page; allowed: with --page HOST:PORT")

    @property
    def page_credentials(self) -> "Credentials | None":
        """Certificates of the page; raises InputError for a folder without them."""
        from hexctl.wire.certificates import find_credentials
        from hexctl.wire.links import Role

        if self.page_keys is None:
            return None
        try:
            return find_credentials(self.page_keys, Role.ROBOT)
        except InputError as error:
            flags = {"credentials": "keys"}
            raise InputError(
                error.worded(lambda name: f"--page-{flags.get(name, flag_name(name))}")
            ) from error


@dataclass(frozen=True, kw_only=True)
class PagedCalibrationOptions(PageOptions, CalibrationOptions):
    """Options of `hexctl calibrate`."""

    def __post_init__(self) -> None:
        check_fields(self)
        self.check_page()
