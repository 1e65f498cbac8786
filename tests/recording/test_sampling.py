"""``--record all|sample:N|none``: which rallies a log holds."""

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.league import LeagueConfig
from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError, Sampling
from shuttle_marl.recording.replay import check
from tests.tournaments import play_league

GAME = default_game()
POOL = ("bc", "bc:viktor-axelsen", "bc:an-se-young")


def test_what_may_be_asked_for() -> None:
    assert [str(Sampling.parse(text)) for text in ("all", "sample:1", "none", "sample:10")] == ["all", "all", "none", "sample:10"]
    for text in ("", "ALL", "sample:0", "sample:1.5", "10"):
        with pytest.raises(RecordingError, match="expected all, none, or sample:N"):
            Sampling.parse(text)
    with pytest.raises(RecordingError, match="sample:N"):
        LogHeader(seed=0, game="", strokes=(), policies=(), record="half")


def test_one_in_n_at_random_and_cells_together(header) -> None:
    """The share is right, matches that share their draws are in together, and the samples of seeds and pairings differ."""
    match = np.arange(200_000)
    pairing = np.zeros(len(match), dtype=np.uint32)
    kept = {}
    for every in (1, 2, 7, 100):
        keeps = Sampling(every=every).keeps(header(), pairing, match)
        cells = keeps.reshape(-1, 2)
        assert (cells[:, 0] == cells[:, 1]).all()
        share, sigma = 1 / every, np.sqrt((1 / every) * (1 - 1 / every) / len(cells))
        assert abs(keeps.mean() - share) <= 4 * sigma
        kept[every] = keeps
    # Who serves first alternates from cell to cell; the sample must not prefer either.
    even = kept[7].reshape(-1, 2)[::2, 0].mean()
    assert abs(even - 1 / 7) < 4 * np.sqrt(6 / 49 / 50_000)
    other_seed = Sampling(every=7).keeps(header(seed=8), pairing, match)
    other_pairing = Sampling(every=7).keeps(header(), pairing + 1, match)
    for other in (other_seed, other_pairing):
        assert (other & kept[7]).mean() == pytest.approx(1 / 49, abs=0.005)
    alone = Sampling(every=7).keeps(header(matches_per_draw=1), pairing, match).reshape(-1, 2)
    assert (alone[:, 0] != alone[:, 1]).any()
    assert not Sampling(every=0).keeps(header(), pairing, match).any()


@pytest.fixture(scope="module")
def sampled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sampled") / "run"
    play_league(LeagueConfig(pool=POOL, matches=60, seed=3, record="sample:4", out=out))
    return out


def test_a_sampled_tournament_holds_whole_matches_that_play_again(sampled: Path, tmp_path: Path) -> None:
    full = LeagueConfig(pool=POOL, matches=60, seed=3, out=tmp_path / "full")
    play_league(full)
    assert (sampled / "results.csv").read_bytes() == (tmp_path / "full" / "results.csv").read_bytes()
    assert check(sampled / "rallies.mcap", GAME).problems == ()
    with RallyLog(sampled / "rallies.mcap") as log, RallyLog(tmp_path / "full" / "rallies.mcap") as all_of_it:
        assert log.header.record == "sample:4"
        some = Rallies.concatenate([batch for _, batch in log.batches()])
        everything = Rallies.concatenate([batch for _, batch in all_of_it.batches()])
        expected = everything.select(Sampling(every=4).keeps(log.header, everything.pairing, everything.match))
    assert 0.1 < len(some) / len(everything) < 0.4
    for field in ("pairing", "match", "rally", "winner", "stroke"):
        assert np.array_equal(getattr(some, field), getattr(expected, field))
    report = (sampled / "report.md").read_text()
    assert "one match in 4, drawn at random, is with all its rallies in `rallies.mcap`" in report
    counted = sum(row["rallies"] for row in pyarrow.parquet.read_table(sampled / "results.parquet").to_pylist())
    assert counted == len(everything)


def test_rallies_that_do_not_belong_to_the_sample_are_found(tmp_path: Path, sampled: Path) -> None:
    with RallyLog(sampled / "rallies.mcap") as log:
        header = dataclasses.replace(log.header, record="sample:5")
        rallies = Rallies.concatenate([batch for _, batch in log.batches()])
    with RallyLogWriter(tmp_path / "a.mcap", header) as log_writer:
        log_writer.append(rallies)
    assert "does not belong to sample:5" in check(tmp_path / "a.mcap").problems[0]
