"""A match as one page, made by the page's own code; that such a page opens is tested in a browser."""

import json
import shutil
from pathlib import Path

import pytest

from shuttle_marl.game import default_game
from shuttle_marl.staging import model_file
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.building import FILES
from shuttle_marl.watch.messages import AnalysisRequest, HelloRequest, RallyRequest
from shuttle_marl.watch.plan import Plan, Side
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.stager import Stager
from tests.watch.conftest import run_script

STAGED = 8
LONGEST = 3 * 59
"""Rallies of a match in which every game is won by 30 to 29."""


@pytest.fixture(scope="module")
def replies(page_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that a page of a match is made of."""
    folder = tmp_path_factory.mktemp("match")
    plan = Plan(seed=2, sides=(Side(policy="bc"), Side(policy="bc")))
    stager = Stager(("male", "male"), ("right", "right"))
    answers = Answers(PolicyTables(default_game(), ("bc",)), plan, stager)
    (folder / "hello").write_bytes(answers(HelloRequest(id=1)))
    for number in range(STAGED):
        for kind, name in ((RallyRequest, "rally"), (AnalysisRequest, "analysis")):
            (folder / f"{name}-{number}").write_bytes(answers(kind(id=1, plan=plan, rally=number)))
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
