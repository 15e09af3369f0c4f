"""Bags are read by the oldest ROS 2 that the documentation promises, by the rules of its metadata reader."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from hexctl.export.mcap import TOPICS, write_mcap
from hexctl.recording.recorded_trial import RecordedTrial


def posed(walk: RecordedTrial) -> RecordedTrial:
    return walk


def without_pose(walk: RecordedTrial) -> RecordedTrial:
    return replace(walk, base_position_world=np.full_like(walk.base_position_world, np.nan))


def without_properties(walk: RecordedTrial) -> RecordedTrial:
    return replace(walk, properties={})


@pytest.mark.parametrize("changed", [posed, without_pose, without_properties])
def test_humble_reads_the_metadata(walk: RecordedTrial, tmp_path: Path, changed: Any) -> None:
    write_mcap(changed(walk), tmp_path / "bag")
    bag = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert bag["version"] < 9
    topics = [one["topic_metadata"] for one in bag["topics_with_message_count"]]
    assert {one["name"] for one in topics} <= set(TOPICS)
    for one in topics:
        profiles = one["offered_qos_profiles"]
        assert isinstance(profiles, str)  # a list is a "bad conversion" there
        for profile in yaml.safe_load(profiles) or []:
            numbers = ("history", "depth", "reliability", "durability", "liveliness")
            assert all(isinstance(profile[name], int) for name in numbers)
    assert sum("durability: 1" in one["offered_qos_profiles"] for one in topics) == 2
    assert (bag["compression_mode"], bag["files"][0]["path"]) == ("", "bag.mcap")


def test_channels_of_the_file_alone_have_the_same_profiles(walk: RecordedTrial, tmp_path: Path) -> None:
    write_mcap(walk, tmp_path / "walk.mcap")
    with (tmp_path / "walk.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        for profile in yaml.safe_load(channel.metadata["offered_qos_profiles"]) or []:
            assert isinstance(profile["reliability"], int)


def test_messages_are_the_same_in_humble() -> None:
    humble, jazzy = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)
    for kind, _ in TOPICS.values():
        assert humble.hash_rihs01(kind) == jazzy.hash_rihs01(kind)
