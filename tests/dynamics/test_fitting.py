"""Small fits on the simulated sample, resampled matches, legal replies, and areas of targets."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.special import expit
from scipy.stats import beta

from shuttle_marl.data import read_matches
from shuttle_marl.data.schema import REASONS, STROKES, Outcome
from shuttle_marl.data.table import strokes_hash
from shuttle_marl.dynamics.compiled import CREDIBLE, PRIOR_STROKES, SHOT_SHARE, catalogue_of, replies_of, support_of
from shuttle_marl.dynamics.features import SLOTS, Rows, rows_from_strokes, target_points
from shuttle_marl.dynamics.fit import fit
from shuttle_marl.dynamics.make import resampled
from shuttle_marl.dynamics.models import EnsembleConfig, fit_ridge, fold_of_match
from shuttle_marl.game import default_game
from shuttle_marl.game.court import area_of
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


def sample() -> Rows:
    return rows_from_strokes(read_matches(SAMPLE))


@pytest.mark.slow
def test_the_same_seed_gives_the_same_weights(tmp_path: Path) -> None:
    rows = sample()
    rows, part = rows.take(rows.match % 2 == 0), rows.match[rows.match % 2 == 0] % 4 == 0
    config = EnsembleConfig(epochs=1, batch=256, folds=5)
    hashes = []
    for seed in (7, 7, 8):
        fitted = fit(rows.take(~part), rows.take(part), seed=seed, config=config, report=lambda line: None)
        hashes.append((fitted.models.save(tmp_path), fitted.support.fault_range.tobytes()))
    assert hashes[0] == hashes[1]
    assert hashes[0] != hashes[2]


def test_contexts_of_a_rally_with_a_missed_serve() -> None:
    table = read_matches(SAMPLE)
    first = table.filter(pa.compute.equal(table["rally"], table["rally"][0])).slice(0, 4)
    assert first["stroke"].to_pylist() == [1, 2, 3, 4]
    whole = rows_from_strokes(first)
    assert whole.codes["incoming_shot"][0] == SLOTS["incoming_shot"] - 2, "none at the serve"
    assert whole.codes["own_shot"][1] == SLOTS["own_shot"] - 2
    assert whole.codes["incoming_shot"][1] == first["shot"][0].as_py()
    assert whole.codes["own_area"][2] == first["area"][0].as_py()
    assert whole.next_contact[0] == first["height"][1].as_py()
    # Without the serve, what came before is unknown, not none.
    missed = rows_from_strokes(first.slice(1))
    assert missed.codes["incoming_shot"][0] == SLOTS["incoming_shot"] - 1
    assert missed.codes["own_shot"][0] == SLOTS["own_shot"] - 2
    assert missed.codes["own_shot"][1] == SLOTS["own_shot"] - 1
    # A gap in a rally breaks the context as well.
    gap = rows_from_strokes(pa.concat_tables([first.slice(0, 1), first.slice(2)]))
    assert gap.codes["incoming_shot"][1] == SLOTS["incoming_shot"] - 1
    assert gap.next_contact[0] == -1
    assert first.schema.equals(STROKES)


def test_the_hash_of_strokes_is_that_of_their_columns() -> None:
    """A description that is worded otherwise must not make a model look as if it were fitted on other data."""
    table = read_matches(SAMPLE)
    fields = [field.with_metadata({"description": "other words"}) for field in table.schema]
    assert strokes_hash(table.cast(pa.schema(fields))) == strokes_hash(table)
    assert strokes_hash(table.slice(1)) != strokes_hash(table)


def test_ridge_learns_an_interaction() -> None:
    """A rule for one technique from above and for the other from below: no sum of single effects can say that."""
    rows = sample()
    backhand, contact = rows.codes["technique"] == 1, rows.codes["contact"] == 1
    truth = expit(np.where(backhand ^ contact, 1.5, -1.5))
    label = np.random.default_rng(2).random(len(rows)) < truth
    p = expit(fit_ridge(rows.codes, label).logits(rows.codes))
    for group in (backhand & contact, backhand & ~contact, ~backhand & contact, ~backhand & ~contact):
        # Shrunk, but on the right side and most of the way.
        assert p[group].mean() == pytest.approx(truth[group].mean(), abs=0.15)
    assert p.mean() == pytest.approx(label.mean(), abs=1e-3)


def test_a_legal_stroke_is_one_that_the_average_player_chooses() -> None:
    rows = rows_from_strokes(read_matches(SAMPLE))
    catalogue = catalogue_of(rows)
    drop, of_drop = SHOTS.index("drop"), catalogue.shot == SHOTS.index("drop")
    lifts = np.flatnonzero(catalogue.shot == SHOTS.index("lift"))
    choices = np.full((len(catalogue), 2, N_SHOTS, N_TECHNIQUES), 0.5)
    forehand = of_drop & (catalogue.technique == 0)
    before = replies_of(rows, catalogue, choices)[lifts]
    assert before[:, forehand].any()
    assert before[:, of_drop & ~forehand].any()
    choices[:, :, drop, 1:] = 0.001
    fewer = replies_of(rows, catalogue, choices)[lifts]
    assert np.array_equal(fewer[:, forehand], before[:, forehand])
    assert not fewer[:, of_drop & ~forehand].any(), "techniques that are hardly ever chosen"
    choices[:, :, drop] = SHOT_SHARE / 10
    assert not replies_of(rows, catalogue, choices)[lifts][:, of_drop].any()


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


def test_only_annotated_winners_and_out_strokes_change_their_areas() -> None:
    table = read_matches(SAMPLE)
    recorded = table["area"].fill_null(-1).to_numpy()
    assert np.array_equal(rows_from_strokes(table).codes["area"], recorded), "simulated strokes record the target itself"
    annotated = table.set_column(table.schema.get_field_index("source"), "source", pa.array(["ShuttleSet"] * len(table)))
    rows = rows_from_strokes(annotated.cast(table.schema))
    changed = rows.codes["area"] != recorded
    floor = (rows.outcome == Outcome.WINNER) | (rows.reason == REASONS.index("out"))
    assert changed.any()
    assert not changed[~floor].any()


def test_a_resample_has_as_many_matches_of_each_discipline_and_copies_share_a_fold() -> None:
    rows = rows_from_strokes(read_matches(SAMPLE))
    again = resampled(rows, [0, 1])
    first = [np.unique(part.match, return_index=True)[1] for part in (rows, again)]
    number = len(first[0])
    drawn = np.unique(again.match)
    assert 0.4 * number < len(drawn) < 0.85 * number, "about 63 % of the matches, some of them more than once"
    lengths = np.bincount(rows.match)
    assert (np.bincount(again.match, minlength=len(lengths))[drawn] % lengths[drawn] == 0).all(), "matches are whole"
    women = [np.bincount(part.match[part.codes["discipline"] == 1]) for part in (rows, again)]
    copies = [count[count > 0] / lengths[np.flatnonzero(count)] for count in women]
    assert copies[0].sum() == copies[1].sum()
    fold = fold_of_match(again.match, 5)
    assert all(len(np.unique(fold[again.match == match])) == 1 for match in drawn)
    assert np.array_equal(resampled(rows, [0, 1]).match, again.match)
    assert not np.array_equal(np.unique(resampled(rows, [0, 2]).match), drawn)


def test_ranges_of_strokes_that_nobody_played_are_those_of_the_prior() -> None:
    rows, drive, game = sample(), SHOTS.index("drive"), default_game()
    kept = rows.take(rows.codes["shot"] != drive)
    targets = np.eye(9)[np.zeros(len(kept.match), dtype=np.int64)]
    found = support_of(kept, targets, game)
    never = np.append(game.catalogue.shot, -1)[game.edge_incoming] == drive
    for ranges, outcome in ((found.fault_range, Outcome.FAULT), (found.winner_range, Outcome.WINNER)):
        rate = (kept.outcome == outcome).mean()
        # Jeffreys prior, and strokes of the prior at the rate of all strokes.
        a, b = PRIOR_STROKES * rate + 0.5, PRIOR_STROKES * (1 - rate) + 0.5
        assert np.ptp(ranges[never], axis=0).max() < 1e-12
        assert ranges[never][0] == pytest.approx(beta.ppf([(1 - CREDIBLE) / 2, (1 + CREDIBLE) / 2], a, b))
