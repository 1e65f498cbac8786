"""The page's reader of packed motions, on the file that every reader has to read."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.staging.motion import from_parents
from tests.watch.conftest import run_script

GOLDEN = Path(__file__).parents[1] / "staging" / "golden"

pytestmark = pytest.mark.slow


def decoded(page_folder: Path, tmp_path: Path, frames: list[int]) -> Any:
    return json.loads(run_script("read.ts", tmp_path, str(GOLDEN / "rally.smot"), *map(str, frames)))


def test_the_golden_motion_is_read_as_it_was_written(page_folder: Path, tmp_path: Path) -> None:
    wanted = json.loads((GOLDEN / "rally.json").read_text(encoding="utf-8"))
    found = decoded(page_folder, tmp_path, [row["frame"] for row in wanted["at"]])
    assert (found["fps"], found["frames"], found["players"]) == (wanted["fps"], wanted["frames"], wanted["players"])
    for row, seen in zip(wanted["at"], found["at"], strict=True):
        assert np.abs(np.array(seen["shuttle"]) - row["shuttle"]).max() < 1e-4
        for seat in (0, 1):
            me = seen["seats"][seat]
            assert me["planted"] == row["planted"][seat]
            local = np.array(me["local"]).reshape(1, -1, 4)
            turn, place = from_parents(
                np.array([me["hips"]]), local, np.array(wanted["parents"][seat]), np.array(wanted["rest"][seat])
            )
            assert np.abs(place[0] - row["position"][seat]).max() < 1e-4
            assert np.abs(np.abs((turn[0] * row["rotation"][seat]).sum(axis=-1)) - 1).max() < 1e-5
