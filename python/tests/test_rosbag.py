"""`mcdpr export --to rosbag2`, decoded by the rosbags package; no ROS installation was at hand."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import mcdpr
import numpy as np
import pytest
from conftest import PROGRAM, program
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore


@pytest.fixture(scope="module")
def bag(recorded: tuple[Path, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag") / "run_bag"
    said = program("export", str(recorded[0]), "--to", "rosbag2", "--out", str(folder), "--json")
    assert {entry["topic"] for entry in said["topics"]} >= {"/joint_states", "/tf", "/diagnostics"}
    return folder


def messages(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    types = get_typestore(Stores.ROS2_HUMBLE)
    found: dict[str, list[tuple[int, Any]]] = {}
    with Reader(bag) as reader:
        for connection, time_ns, data in reader.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            # The decoder's own writing of it: every byte was understood.
            assert bytes(types.serialize_cdr(message, connection.msgtype)) == data
            found.setdefault(connection.topic, []).append((time_ns, message))
        assert reader.message_count == sum(map(len, found.values()))
    return found


def test_a_bag_says_what_the_record_says(recorded: tuple[Path, Any], bag: Path) -> None:
    found = messages(bag)
    record = mcdpr.Record.load(recorded[0])
    joints = [message for _, message in found["/joint_states"]]
    assert joints[0].name == ["winch_1", "winch_2", "winch_3", "winch_4"]
    lengths = np.array([message.position for message in joints])
    assert np.abs(lengths - record.ticks["lengths_m"]).max() < 1e-7
    efforts = np.array([message.effort for message in joints])
    assert np.abs(efforts - record.ticks["tensions_n"]).max() < 1e-6
    platform = [m.transforms[0] for _, m in found["/tf"] if m.transforms[0].child_frame_id == "platform"]
    places = np.array([[getattr(t.transform.translation, k) for k in "xyz"] for t in platform])
    assert np.abs(places - record.truth["position_m"]).max() < 1e-6
    fixed = {m.transforms[0].child_frame_id for _, m in found["/tf_static"]}
    assert fixed == {"tool", "camera"}
    # What four cables pull carries the weight, as the statics have it.
    weight = mcdpr.Robot.load("paper-table5").values["platform"]["mass_kg"] * 9.80665
    pulls = [found[f"/cables/cable_{k}/wrench"][-1][1].wrench.force for k in range(1, 5)]
    assert sum(force.z for force in pulls) == pytest.approx(weight, rel=0.1)
    status = [m.status[0] for _, m in found["/diagnostics"]]
    assert status[-1].message == "Disarmed" and status[-1].level == 0
    assert {"tick", "state", "fault"} <= {pair.key for pair in status[0].values}
    lens = found["/camera/camera_info"][0][1]
    assert lens.distortion_model == "plumb_bob" and lens.k[0] > 0 and len(lens.p) == 12


def test_definitions_are_those_of_ros(bag: Path) -> None:
    """The definitions in the file, parsed by rosbags, are the types that it knows by that name."""
    from rosbags.typesys import get_types_from_msg

    types = get_typestore(Stores.ROS2_HUMBLE)
    with next(bag.glob("*.mcap")).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and len(summary.schemas) >= 5
    for schema in summary.schemas.values():
        assert schema.encoding == "ros2msg"
        for name, (_, fields) in get_types_from_msg(schema.data.decode(), schema.name).items():
            known = [field for field, _ in types.fielddefs[name][1]]
            assert [field for field, _ in fields] == known, name


def test_what_is_no_record_becomes_no_bag(tmp_path: Path) -> None:
    words = [PROGRAM, "export", str(tmp_path), "--to", "rosbag2"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "there is no recorded run" in done.stderr
    assert not list(tmp_path.iterdir())
