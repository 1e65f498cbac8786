"""A match as one page, made by the page's own code; that such a page opens is tested in a browser."""

import json
import shutil
from pathlib import Path

import pytest

from shuttle_marl.game import default_game
from shuttle_marl.staging import model_file
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.building import FILES
from shuttle_marl.watch.plan import Side
from shuttle_marl.watch.stager import Stager
from shuttle_marl.watch.tables import Tables
from tests.watch.conftest import run_script

STAGED = 8
LONGEST = 3 * 59
"""Rallies of a match in which every game is won by 30 to 29."""


@pytest.fixture(scope="module")
def replies(page_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that a page of a match is made of."""
    folder = tmp_path_factory.mktemp("match")
    answers = Answers(
        Tables(default_game(), ("bc",)),
        (Side(policy="bc"), Side(policy="bc")),
        2,
        Stager(default_game(), ("male", "male"), ("right", "right")),
    )
    plan = {"seed": 2, "sides": [{"policy": "bc", "temperature": 1}] * 2}
    (folder / "hello").write_bytes(answers({"id": 1, "op": "hello"}))
    for number in range(STAGED):
        for op in ("rally", "analysis"):
            (folder / f"{op}-{number}").write_bytes(answers({"id": 1, "op": op, "plan": plan, "rally": number}))
    for path in (model_file("male"), *(page_folder / name for name in FILES)):
        shutil.copy(path, folder / path.name)
    return folder


@pytest.mark.slow
def test_the_longest_match_fits_into_ten_megabytes(replies: Path, tmp_path: Path) -> None:
    short, longest = (json.loads(run_script("share.ts", tmp_path, str(replies), str(count))) for count in (STAGED, LONGEST))
    assert longest["seconds"] > 35 * 60
    assert longest["bytes"] <= 10e6
    # A thumb's breadth where a racket ends, in a match that is much longer than any that is played.
    assert short["turn"] < 0.05
    assert longest["turn"] < 0.1
    assert short["place"] < 0.002
    assert longest["place"] < 0.002
