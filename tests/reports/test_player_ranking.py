"""Players ranked: order, intervals, who is left out."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from shuttle_marl.reports import AnalysisError, rank_players


def table(rng: np.random.Generator, means: dict[str, float], matches: int, strokes: int = 40, between: float = 0.02) -> pa.Table:
    """Strokes whose values have a mean a player, one a match, and noise."""
    rows: dict[str, list[object]] = {name: [] for name in ("player", "match", "discipline", "value_added", "decision")}
    for player, mean in means.items():
        for match in range(matches):
            form = mean + rng.normal(0, between)
            values = form + rng.normal(0, 0.1, strokes)
            rows["player"] += [player] * strokes
            rows["match"] += [f"{player}-{match}"] * strokes
            rows["discipline"] += ["WS" if player.startswith("w") else "MS"] * strokes
            rows["value_added"] += values.tolist()
            rows["decision"] += (values / 2).tolist()
    return pa.table(rows)


def test_order_and_counts() -> None:
    played = table(np.random.default_rng(0), {"a": 0.0, "b": 0.3, "c": -0.3}, 6)
    found = rank_players(played)
    assert [p.player for p in found] == ["b", "a", "c"]
    assert [(p.matches, p.strokes) for p in found] == [(6, 240)] * 3
    for p in found:
        assert p.low < p.value < p.high
        assert p.decision == pytest.approx(p.value / 2)
    mine = played.filter(pc.equal(played["player"], "b"))
    assert found[0].value == pytest.approx(pc.mean(mine["value_added"]).as_py())
    assert rank_players(played) == found


@pytest.mark.parametrize("matches", [3, 10])
def test_intervals_have_their_nominal_coverage(matches: int) -> None:
    rng = np.random.default_rng(1)
    held = []
    for _ in range(60):
        found = rank_players(table(rng, dict.fromkeys("abcde", 0.0), matches, strokes=70, between=0.05))
        held += [p.low <= 0 <= p.high for p in found]
    assert 0.92 <= np.mean(held) <= 0.985


def test_players_with_too_few_matches_are_left_out() -> None:
    rng = np.random.default_rng(2)
    played = pa.concat_tables([table(rng, {"a": 0.0}, 5), table(rng, {"b": 0.0}, 2, strokes=500)])
    assert [p.player for p in rank_players(played)] == ["a"]
    assert {p.player for p in rank_players(played, least_matches=2)} == {"a", "b"}
    with pytest.raises(AnalysisError, match="no player with 9 matches"):
        rank_players(played, least_matches=9)


def test_centred_on_the_discipline() -> None:
    played = table(np.random.default_rng(3), {"m1": 0.2, "m2": 0.4, "w1": -0.5, "w2": -0.3}, 6, between=0.0)
    found = {p.player: p.value for p in rank_players(played, centred=True)}
    assert found["m1"] == pytest.approx(-0.1, abs=0.02)
    assert found["w2"] == pytest.approx(0.1, abs=0.02)
    assert sum(found.values()) == pytest.approx(0, abs=1e-12)


def test_unknown_values_do_not_count() -> None:
    played = table(np.random.default_rng(4), {"a": 0.1}, 6)
    values = played["value_added"].to_numpy().copy()
    values[::3] = np.nan
    holes = played.set_column(3, "value_added", pa.array(values, pa.float64(), from_pandas=True))
    found = rank_players(holes, least_strokes=100)[0]
    assert found.strokes == 160
    assert found.value == pytest.approx(np.nanmean(values))
