"""The size of a match as one page, from what goes into it; that such a page opens is tested with a rally in a browser."""

import base64
import gzip
from pathlib import Path

import pytest

from shuttle_marl.game import default_game
from shuttle_marl.staging import model_file
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.building import FILES
from shuttle_marl.watch.plan import Side
from shuttle_marl.watch.stager import Stager
from shuttle_marl.watch.tables import Tables


def packed(content: bytes) -> int:
    """Bytes of a part of a shared page."""
    return len(base64.b64encode(gzip.compress(content, 6)))


@pytest.mark.slow
def test_a_match_of_two_games_fits_into_ten_megabytes(page_folder: Path) -> None:
    game = default_game()
    answers = Answers(
        Tables(game, ("bc",)), (Side(policy="bc"), Side(policy="bc")), 2, Stager(game, ("male", "male"), ("right", "right"))
    )
    plan = {"seed": 2, "sides": [{"policy": "bc", "temperature": 1}] * 2}
    size = sum((page_folder / name).stat().st_size for name in FILES) + packed(model_file("male").read_bytes())
    rallies = 0
    while True:
        try:
            size += sum(packed(answers({"id": 1, "op": op, "plan": plan, "rally": rallies})) for op in ("rally", "analysis"))
        except WatchError:  # the match is over
            break
        rallies += 1
    assert rallies == 65
    assert size <= 10e6
