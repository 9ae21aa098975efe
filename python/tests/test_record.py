"""Recorded runs and calibrations as arrays."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import mcdpr
import numpy as np
import polars
import pytest
from conftest import program


def test_a_record_is_what_the_run_was(recorded: tuple[Path, Any], tmp_path: Path) -> None:
    folder, said = recorded
    record = mcdpr.Record.load(folder)
    assert record.damage is None and record.gaps == 0
    assert record.scenario["machine"] and record.duration_s > 10.0
    ticks, truth, plan = record.ticks, record.truth, record.plan
    assert ticks["lengths_m"].shape == (len(ticks["tick"]), 4)
    assert np.all(np.diff(ticks["tick"].astype(np.int64)) > 0)
    # The figure of the program, from the record alone.
    moving = np.isfinite(ticks["path_s"]) & np.isfinite(ticks["planned_lengths_m"]).all(axis=1)
    error = np.abs(ticks["lengths_m"] - ticks["planned_lengths_m"])[moving]
    assert error.mean() == pytest.approx(said["cable_length_error_m"]["mean"], rel=0.1)
    on = (truth["path_s"] > 0) & (truth["path_s"] < plan["path_s"][-1])
    wanted = np.stack(
        [np.interp(truth["path_s"][on], plan["path_s"], plan["tool_m"][:, k]) for k in range(3)], 1
    )
    path = np.linalg.norm(truth["tool_m"][on] - wanted, axis=1)
    assert path.mean() == pytest.approx(said["path_error_m"]["mean"], rel=0.05)
    # The tables of `mcdpr export` are the same numbers, rounded.
    program("export", str(folder), "--csv", "--out", str(tmp_path), "--json")
    tables = sorted(tmp_path.glob("*.csv"))
    with next(t for t in tables if "truth" in t.name).open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(truth["tick"])
    assert abs(float(rows[100]["tool_x_m"]) - truth["tool_m"][100, 0]) < 1e-6
    words = [what for _, what in record.changes]
    assert "Moving" in words and record.status["state"][-1] == "Disarmed"


def test_a_topic_is_a_table(recorded: tuple[Path, Any]) -> None:
    record = mcdpr.Record.load(recorded[0])
    table = record.to_pandas("ticks")
    assert len(table) == len(record.ticks["tick"])
    assert list(table.columns[:3]) == ["tick", "path_s", "lengths_m.1"]
    assert {"tool_m.x", "rotation_xyzw.w"} <= set(record.to_pandas("truth").columns)


def test_another_library_takes_the_table(recorded: tuple[Path, Any]) -> None:
    record = mcdpr.Record.load(recorded[0])
    table = polars.from_dataframe(record.to_pandas("truth"))
    assert table.height == len(record.truth["tick"])
    assert table["tool_m.x"].to_list() == record.truth["tool_m"][:, 0].tolist()


def test_what_is_no_record_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with pytest.raises(mcdpr.RecordError, match="there is no recorded run"):
        mcdpr.Record.load(file)
    file.write_bytes(b"something else")
    with pytest.raises(mcdpr.RecordError, match="cannot be read"):
        mcdpr.Record.load(file)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Calibration data of a simulated robot, as the program collects them."""
    folder = tmp_path_factory.mktemp("calibration")
    program("calibrate", "all", "--poses", "8", "--seed", "1", "--json", cwd=folder)
    data = next(f for f in folder.glob("*.json") if "data" in f.name)
    # Again from the file: written numbers are those that the package reads.
    words = ("calibrate", "all", "--data", str(data), "--out", "again.calibration.json", "--json")
    (folder / "said.json").write_text(json.dumps(program(*words, cwd=folder)))
    return folder


def test_a_calibration_is_the_program_s(measured: Path) -> None:
    data = next(f for f in measured.glob("*.json") if "data" in f.name)
    said = json.loads((measured / "said.json").read_text())
    found = mcdpr.calibrate(data)
    at_rest = said.pop("at_rest")
    assert found.document == said
    assert 1e-4 < at_rest["position_m"] < at_rest["worst_position_m"] < 0.01
    assert (found.anchors_m * 1e3).round(9).tolist() == np.round(said["anchors_mm"], 9).tolist()
    covariance = found.covariance
    assert covariance is not None and covariance.shape == (len(found.unknowns),) * 2
    assert np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > -1e-12
    k = found.unknowns.index("cable.2.anchor.y_m")
    assert 1e-6 < np.sqrt(covariance[k, k]) < 0.05
    # Two ways to the calibrated robot: the program's file, and the answer itself.
    robot = mcdpr.Robot.load("paper-table5")
    by_file = robot.calibrated(measured / "again.calibration.json")
    by_answer = robot.calibrated(found)
    assert by_file.is_calibrated and by_file.values == by_answer.values
    again = by_answer.at_rest()
    assert again == pytest.approx(at_rest)
    assert by_answer.values["cables"][0]["anchor_in_world_m"] != robot.values["cables"][0][
        "anchor_in_world_m"
    ]


def test_bad_data_are_refused_with_their_place(measured: Path) -> None:
    data = json.loads(next(f for f in measured.glob("*.json") if "data" in f.name).read_text())
    data["poses"][3]["encoder_dl_mm"][2] = "x"
    with pytest.raises(mcdpr.CalibrationError, match=r"poses\[3\].encoder_dl_mm\[2\]") as refused:
        mcdpr.calibrate(data)
    assert refused.value.path == "poses[3].encoder_dl_mm[2]"
    with pytest.raises(mcdpr.CalibrationError, match="no-such.json"):
        mcdpr.calibrate("no-such.json")
