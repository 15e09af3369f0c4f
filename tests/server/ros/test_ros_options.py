"""What ROS means for where a robot listens."""

import pytest

from hexctl.errors import InputError
from hexctl.server.ros.ros_options import ENDPOINT_BESIDE_ROUTER, RosOptions
from hexctl.wire.links import load_link


def test_the_default_port_is_left_to_the_router() -> None:
    assert RosOptions().link_beside_router(load_link()).endpoint == ENDPOINT_BESIDE_ROUTER


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447", "tls/localhost:7447"])
def test_a_robot_that_is_told_to_listen_there_is_refused(endpoint: str) -> None:
    with pytest.raises(InputError, match="7448"):
        RosOptions().link_beside_router(load_link(endpoint=endpoint))


def test_other_ports_and_other_computers_do_not_clash() -> None:
    other = load_link(endpoint="tcp/127.0.0.1:7500")
    assert RosOptions().link_beside_router(other) == other
    assert RosOptions(router="tcp/10.0.0.2:7447").link_beside_router(load_link()) == load_link()


def test_options_are_checked_when_they_are_given() -> None:
    with pytest.raises(InputError, match="ros_domain"):
        RosOptions(domain=999)
    with pytest.raises(InputError, match=r"^ros: got"):
        RosOptions(router="7447")


def test_an_operator_is_told_who_may_drive_and_where_the_robot_listens() -> None:
    moved = RosOptions().link_beside_router(load_link())
    beside, may = RosOptions().warnings(moved)
    assert "--connect tcp/127.0.0.1:7448" in beside
    assert "may stop" in may
    (may,) = RosOptions(drive=True).warnings(load_link(endpoint="tcp/127.0.0.1:7500"))
    assert "may drive" in may
