"""Legal replies, counted again stroke by stroke."""

import collections
from pathlib import Path

import numpy as np

from shuttle_marl.data import load_strokes
from shuttle_marl.dynamics.compiled import MIN_STYLE, SHOT_SHARE, catalogue_of, replies_of
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.game.court import AREAS, BACK, third_of
from shuttle_marl.game.stroke import FRONT_COURT, N_SHOTS, SHOTS

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


def counted(rows: Rows) -> collections.Counter[tuple[int, str, int, int]]:
    """Replies by incoming shot type, third of the court, contact and own shot type; the third is read from the area's name."""
    count: collections.Counter[tuple[int, str, int, int]] = collections.Counter()
    columns = (rows.codes[name].tolist() for name in ("incoming_shot", "incoming_area", "contact", "shot"))
    for incoming, area, contact, shot in zip(*columns, strict=True):
        if incoming < N_SHOTS and area < len(AREAS):
            count[incoming, AREAS[area].split("-")[0], contact, shot] += 1
    return count


def test_people_choose_the_shot_type_of_a_legal_reply() -> None:
    rows = rows_from_strokes(load_strokes(SAMPLE))
    catalogue = catalogue_of(rows)
    replies, count = replies_of(rows, catalogue), counted(rows)
    chosen = fallback = 0
    for incoming in range(len(catalogue)):
        third, shot = AREAS[catalogue.area[incoming]].split("-")[0], int(catalogue.shot[incoming])
        for contact in (0, 1):
            legal = np.flatnonzero(replies[incoming] & (catalogue.height == contact))
            total = sum(count[shot, third, contact, other] for other in range(N_SHOTS))
            often = {
                other for other in range(N_SHOTS) if count[shot, third, contact, other] >= max(MIN_STYLE, SHOT_SHARE * total)
            }
            if {int(catalogue.shot[z]) for z in legal} <= often:
                chosen += 1
            else:
                fallback += 1
                assert total < 100, "only little data needs the fallback"
    assert chosen > fallback


def test_the_front_court_stays_in_front() -> None:
    """Also in little data, where the last fallback decides."""
    rows = rows_from_strokes(load_strokes(SAMPLE))
    for part in (rows, rows.take(rows.match % 8 == 0)):
        catalogue = catalogue_of(part)
        back = np.flatnonzero(third_of(catalogue.area) == BACK)
        front = np.isin(np.array(SHOTS)[catalogue.shot], FRONT_COURT)
        assert not replies_of(part, catalogue)[back][:, front].any()
