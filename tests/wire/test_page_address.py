import pytest

from hexctl.errors import InputError
from hexctl.wire.page_address import PageAddress


@pytest.mark.parametrize("text", ["", ":", "host", "host:", "1.2.3.4:99999", "a:b"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="page: got "):
        PageAddress.parse(text)


@pytest.mark.parametrize(
    ("text", "host", "loopback"),
    [("8017", "127.0.0.1", True), ("localhost:1", "localhost", True), ("[::1]:1", "::1", True),
     ("0.0.0.0:1", "0.0.0.0", False), ("robot.local:1", "robot.local", False)],  # noqa: S104
)  # fmt: skip
def test_addresses_are_parsed(text: str, host: str, loopback: bool) -> None:
    address = PageAddress.parse(text)
    assert (address.host, address.loopback) == (host, loopback)
