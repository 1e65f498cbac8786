"""Targets of winners and of out strokes mean the same as those of returned strokes, on strokes whose targets are known."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import rows_from_strokes, target_points
from shuttle_marl.game.court import HALF_LENGTH, area_of

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
N = 20_000
BEYOND = 2.4
"""Distance from where a shuttle would be met to where it comes down [m], for one shot type; half of it for the other."""


def simulated() -> dict[str, np.ndarray]:
    """Strokes with known targets; whether they win depends on their side, not on their depth."""
    rng = np.random.default_rng(3)
    shot, height = rng.integers(5, 7, N), rng.integers(0, 2, N)
    start = np.stack([rng.uniform(-2, 2, N), rng.uniform(-5, -2, N)], axis=1)
    target = np.stack([rng.uniform(-2.5, 2.5, N), np.clip(rng.normal(2.5 + 0.8 * height, 1.0, N), 0.3, 6)], axis=1)
    wins = rng.random(N) < np.where(area_of(*target.T) % 3 == 1, 0.03, 0.12)
    # The flight is longer the flatter it is; a noise, because no two shuttles fall alike.
    farther = BEYOND / (shot - 4) + rng.normal(0, 0.15, N)
    floor = start + (target - start) * ((target[:, 1] + farther - start[:, 1]) / (target[:, 1] - start[:, 1]))[:, None]
    return {"shot": shot, "height": height, "start": start, "target": target, "wins": wins,
            "landing": np.where(wins[:, None], floor, target)}  # fmt: skip


def test_winners_stand_where_they_would_have_been_met() -> None:
    s = simulated()
    truth, wins = area_of(*s["target"].T), s["wins"]
    recorded = area_of(*s["landing"].T)
    met = target_points(s["landing"], s["start"], s["shot"], s["height"], wins, np.zeros(N, dtype=bool))
    found = area_of(*met.T)

    def errors(area: np.ndarray) -> float:
        """Largest error of a win rate by area with at least 200 strokes."""
        many = [a for a in range(9) if (area == a).sum() >= 200 and (truth == a).sum() >= 200]
        return max(abs(wins[area == a].mean() - wins[truth == a].mean()) for a in many)

    assert (recorded == truth)[wins].mean() < 0.6, "the recorded areas must be wrong for this test to mean anything"
    assert (found == truth)[wins].mean() > 0.85
    assert errors(recorded) > 0.1
    assert errors(found) < 0.02
    assert np.array_equal(met[~wins], s["landing"][~wins]), "returned strokes stay where they are"
    # Along the line of flight.
    way, moved = s["landing"] - s["start"], met - s["start"]
    assert np.abs(way[:, 0] * moved[:, 1] - way[:, 1] * moved[:, 0]).max() < 1e-9


def test_out_strokes_stand_where_strokes_are_met() -> None:
    s = simulated()
    out = np.zeros(N, dtype=bool)
    out[:3] = True
    landing, shot, height, wins = s["landing"].copy(), s["shot"].copy(), s["height"].copy(), s["wins"].copy()
    landing[:3] = [[0, HALF_LENGTH + 0.5], [0, HALF_LENGTH + 1.5], [-3, 1.5]]
    s["start"][:3], shot[:3], height[:3], wins[:3] = [1, -3], 6, 0, False
    met = target_points(landing, s["start"], shot, height, wins, out)
    returned = ~wins & ~out & (shot == 6) & (height == 0)
    deepest = np.quantile(landing[returned, 1], 0.9)
    assert met[:2, 1] == pytest.approx(deepest)
    assert (met[:2, 0] > 0).all(), "nearer to where the flight began"
    assert np.array_equal(met[2], landing[2]), "beside the court, but not too deep"


def test_only_annotated_winners_and_out_strokes_change_their_areas() -> None:
    table = load_strokes(SAMPLE)
    recorded = table["area"].fill_null(-1).to_numpy()
    assert np.array_equal(rows_from_strokes(table).codes["area"], recorded), "simulated strokes record the target itself"
    annotated = table.set_column(table.schema.get_field_index("source"), "source", pa.array(["ShuttleSet"] * len(table)))
    rows = rows_from_strokes(annotated.cast(table.schema))
    changed = rows.codes["area"] != recorded
    floor = (rows.outcome == Outcome.WINNER) | (rows.reason == REASONS.index("out"))
    assert changed.any()
    assert not changed[~floor].any()
