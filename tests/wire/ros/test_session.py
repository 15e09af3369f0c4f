"""Which ROS routers are allowed."""

import pytest

from hexctl.errors import InputError
from hexctl.wire.ros.session import check_router


@pytest.mark.parametrize(
    "text", ["tls/localhost:7447", "tcp/0.0.0.0:7447", "tcp/[::]:7447", "localhost:7447"]
)
def test_what_is_no_routers_address_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        check_router(text, insecure=True)


def test_a_router_beyond_this_computer_is_allowed_deliberately() -> None:
    with pytest.raises(InputError, match="beyond this computer"):
        check_router("tcp/192.168.1.5:7447", insecure=False)
    assert check_router("tcp/192.168.1.5:7447", insecure=True).port == 7447
    assert check_router("tcp/localhost:7447", insecure=False).is_loopback
