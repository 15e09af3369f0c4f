"""Which ROS routers are allowed."""

import socket

import pytest

from hexctl.errors import InputError
from hexctl.wire.links import Endpoint
from hexctl.wire.ros.ros_session import GREETING_S, RouterWatch, check_router


@pytest.mark.parametrize(
    "text", ["tls/localhost:7447", "tcp/0.0.0.0:7447", "tcp/[::]:7447", "localhost:7447"]
)
def test_what_is_no_routers_address_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="ros: got"):
        check_router(text, insecure=True)


def test_a_router_beyond_this_computer_is_allowed_deliberately() -> None:
    with pytest.raises(InputError, match="beyond this computer"):
        check_router("tcp/192.168.1.5:7447", insecure=False)
    assert check_router("tcp/192.168.1.5:7447", insecure=True).port == 7447
    assert check_router("tcp/localhost:7447", insecure=False).is_loopback


def test_a_router_that_is_not_there_and_one_that_is_none_are_told_apart() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        endpoint = Endpoint.parse(f"tcp/127.0.0.1:{other.getsockname()[1]}")
        watch = RouterWatch(endpoint)
        assert watch.trouble(False, 10.0) is None, "it may be a router that has just begun to listen"
        assert watch.trouble(False, 10.0 + GREETING_S) == (
            f"what listens at {endpoint} is no ROS router; if it is hexctl serve, give that another port "
            "with --listen"
        )
    assert "yet; ros2 run rmw_zenoh_cpp rmw_zenohd" in str(watch.trouble(False, 30.0))
    assert watch.trouble(True, 40.0) is None
    assert "any more" in str(watch.trouble(False, 50.0))
