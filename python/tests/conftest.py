"""What the tests share: the program that the package's answers must equal."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("MCDPR_PROGRAM", str(ROOT / "target" / "release" / "mcdpr"))
ROBOTS = ["paper-table5", "lab-direct", "eight-cable", "point-anchor"]


def program(*words: str, lines: list[Any] | None = None, cwd: Path | None = None) -> Any:
    """The program's JSON: one document, or one per line of a batch."""
    text = None if lines is None else "".join(json.dumps(line) + "\n" for line in lines)
    done = subprocess.run(
        [PROGRAM, *words], input=text, capture_output=True, text=True, cwd=cwd, timeout=300
    )
    if lines is not None:
        return [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def refusal(*words: str, cwd: Path | None = None) -> str:
    """What the program says as it refuses, without the frames around it."""
    done = subprocess.run([PROGRAM, *words], capture_output=True, text=True, cwd=cwd, timeout=300)
    assert done.returncode != 0
    return " ".join(done.stderr.replace("│", " ").replace("├─▶", " ").split())


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A recorded run of the demo, and what the program said of it."""
    folder = tmp_path_factory.mktemp("record") / "run"
    words = ("run", "paper:table7", "--seed", "3", "--record", str(folder), "--json")
    return folder, program(*words, cwd=folder.parent)
