"""Logs that are resumed, and folders with the logs of several writers."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from shuttle_marl.recording import LogHeader, Player, Rallies, RallyLog, RallyLogWriter, RecordingError
from shuttle_marl.recording.header import DamagedLogError
from shuttle_marl.recording.log_file import unfinished
from shuttle_marl.recording.recorder import resume


class TestResume:
    def write(self, path: Path, header: LogHeader, parts: Sequence[Rallies], stop_after: int | None = None) -> Path:
        log = RallyLogWriter(path, header, batch_rallies=8)
        for i, part in enumerate(parts):
            log.append(part)
            log.flush()
            if stop_after == i:
                log.abort()
                return path
        log.close()
        return path

    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 12), st.integers(0, 12), st.integers(0, 1500), st.booleans())
    def test_bytes_are_the_same(
        self, tmp_path_factory, rallies, header, stop: int, keep: int, torn: int, recovered: bool
    ) -> None:
        folder = tmp_path_factory.mktemp("resumed")
        parts = [rallies(20, seed) for seed in range(12)]
        self.write(folder / "whole.mcap", header(), parts)
        path = self.write(folder / "cut.mcap", header(), parts, stop)
        if stop < 12:
            content = unfinished(path).read_bytes()
            unfinished(path).write_bytes(content[: len(content) - torn])
        keep = min(keep, stop + 1, 12)
        try:
            log = resume(path, header(), 20 * keep, batch_rallies=8)
        except RecordingError:
            assert torn
            assert keep > 0
            return
        with log:
            for part in parts[keep:]:
                log.append(part)
                log.flush()
        assert sorted(file.name for file in folder.iterdir()) == ["cut.mcap", "whole.mcap"]
        assert path.read_bytes() == (folder / "whole.mcap").read_bytes()

    def test_a_resumption_that_was_killed(self, tmp_path: Path, rallies, header) -> None:
        parts = [rallies(20, seed) for seed in range(8)]
        whole = self.write(tmp_path / "whole.mcap", header(), parts)
        path = self.write(tmp_path / "cut.mcap", header(), parts, 7)
        unfinished(path).replace(tmp_path / "cut.mcap.part.old")
        unfinished(path).write_bytes(b"a copy that was cut off")
        with resume(path, header(), 60, batch_rallies=8) as log:
            for some in parts[3:]:
                log.append(some)
                log.flush()
        assert path.read_bytes() == whole.read_bytes()
        assert sorted(file.name for file in tmp_path.iterdir()) == ["cut.mcap", "whole.mcap"]

    def test_a_log_with_a_hole_is_not_resumed(self, tmp_path: Path, rallies, header) -> None:
        path = self.write(tmp_path / "cut.mcap", header(), [rallies(8, seed) for seed in range(4)], 3)
        content = unfinished(path).read_bytes()
        at = content.index(b"zstd", len(content) // 3)  # the chunk of the second or third batch
        unfinished(path).write_bytes(content[: at + 60] + bytes([content[at + 60] ^ 1]) + content[at + 61 :])
        with pytest.raises(RecordingError, match="has played 32 rallies"):
            resume(path, header(), 32)

    def test_the_log_of_another_run_is_not_deleted(self, tmp_path: Path, rallies, header) -> None:
        path = self.write(tmp_path / "a.mcap", header(), [rallies(20)])
        content = path.read_bytes()
        with pytest.raises(RecordingError, match="the log of another run"):
            resume(path, header(seed=1), 0)
        assert path.read_bytes() == content
        path = self.write(tmp_path / "cut.mcap", header(), [rallies(20, seed) for seed in range(4)], 3)
        with pytest.raises(RecordingError, match="another game, other policies or another seed"):
            resume(path, header(seed=1), 60)
        for count in (100, 61):
            with pytest.raises(RecordingError, match=f"has played {count} rallies"):
                resume(path, header(), count)
        assert list(tmp_path.glob("cut*.part.old")), "what was played is still there"
        with pytest.raises(RecordingError, match="is missing"):
            resume(tmp_path / "nothing.mcap", header(), 1)


class TestFolders:
    @pytest.fixture
    def shards(self, tmp_path: Path, rallies, header) -> Path:
        """Three writers with policies and pairings of their own; and a scene that is none of this."""
        policies = [Player(name=name) for name in ("a", "b", "c")]
        for worker in range(3):
            own = header(
                seed=worker, policies=tuple(policies[worker:] + policies[:worker])[:2], pairings=(worker + 10, worker + 11, 5)
            )
            with RallyLogWriter(tmp_path / f"worker-{worker}.mcap", own, batch_rallies=16) as log:
                log.append(rallies(100, seed=worker))
        scene = Writer(str(tmp_path / "scene.mcap"))
        scene.start(profile="")
        scene.finish()
        return tmp_path

    def test_a_folder_is_one_table(self, shards: Path, rallies) -> None:
        wholes = [rallies(100, seed=worker) for worker in range(3)]
        with RallyLog(shards) as log:
            assert len(log.files) == 3
            assert (log.n_rallies, [player.name for player in log.policies]) == (300, ["a", "b", "c"])
            assert log.pairings == (10, 11, 5, 12, 13)
            table, strokes = log.rally_table(), log.stroke_table()
            assert table["number"].to_pylist() == list(range(300))
            assert table["seed"].to_pylist() == [0] * 100 + [1] * 100 + [2] * 100
            pairs = [("a", "b"), ("b", "c"), ("c", "a")]
            expected = [pairs[w][i] for w in range(3) for i in wholes[w].policy[:, 0]]
            assert table["policy_0"].to_pylist() == expected
            keys = [(w + 10, w + 11, 5)[i] for w in range(3) for i in wholes[w].pairing]
            assert [log.pairings[i] for i in table["pairing"].to_pylist()] == keys
            assert strokes.num_rows == sum(len(whole.stroke) for whole in wholes)
            for number in (0, 99, 100, 217, 299):
                assert np.array_equal(
                    log.rally(number).stroke, wholes[number // 100].slice(number % 100, number % 100 + 1).stroke
                )
            with pytest.raises(RecordingError, match="share no header"):
                _ = log.header

    def test_policies_of_one_name(self, tmp_path: Path, rallies, header) -> None:
        """Two checkpoints that were both called ppo are two policies and one word."""
        for worker in range(2):
            own = header(policies=(Player(name="ppo", hash=str(worker)), Player(name="bc")))
            with RallyLogWriter(tmp_path / f"{worker}.mcap", own) as log:
                log.append(rallies(40, seed=worker))
        with RallyLog(tmp_path) as log:
            assert [player.hash for player in log.policies] == ["0", "", "1"]
            column = log.rally_table()["policy_0"].combine_chunks()
            assert column.dictionary.to_pylist() == ["ppo", "bc"]
            assert column.to_pylist() == [("ppo", "bc")[i] for w in range(2) for i in rallies(40, seed=w).policy[:, 0]]

    def test_folders_that_are_no_log(self, tmp_path: Path, rallies, header) -> None:
        with pytest.raises(RecordingError, match="holds no rally log"):
            RallyLog(tmp_path)
        for name, game in (("a", "0" * 64), ("b", "1" * 64)):
            RallyLogWriter(tmp_path / f"{name}.mcap", header(game=game)).close()
        with pytest.raises(RecordingError, match=r"b\.mcap: other game than"):
            RallyLog(tmp_path)
        (tmp_path / "a.mcap").write_bytes((tmp_path / "b.mcap").read_bytes()[:-100])
        with pytest.raises(DamagedLogError, match=r"a\.mcap: damaged"):
            RallyLog(tmp_path)

    def test_rallies_that_two_logs_share_count_once(self, tmp_path: Path, rallies, header) -> None:
        """The larger log is read, also where the other one begins later; a run of another seed is another one."""
        logs = {"a": (header(), rallies(200).slice(40, 100)), "b": (header(), rallies(200))}
        logs["c"] = header(seed=8), rallies(200)
        for name, (about, played) in logs.items():
            with RallyLogWriter(tmp_path / f"{name}.mcap", about, batch_rallies=64) as log:
                log.append(played)
        with pytest.warns(UserWarning, match=r"a\.mcap: left out, because it holds the rallies of b\.mcap"):
            both = RallyLog(tmp_path)
        with both:
            assert [file.path.name for file in both.files] == ["b.mcap", "c.mcap"]
            assert both.n_rallies == 400
            assert both.numbers_of_match(1, 90, rally=300).tolist() == [290]
            with pytest.raises(RecordingError, match=r"b\.mcap, c\.mcap have a match 90 of pairing 1 each; name one"):
                both.numbers_of_match(1, 90)

    def test_logs_that_share_a_part_of_their_rallies_are_not_added_up(self, tmp_path: Path, rallies, header) -> None:
        whole, other = rallies(200), dataclasses.replace(rallies(50, seed=9), pairing=np.ones(50, np.uint32))
        shared = whole.slice(0, int((whole.pairing == 0).sum()))
        for name, pairings, parts in (("a", (3, 4, 5), [whole]), ("b", (3, 99), [shared, other])):
            with RallyLogWriter(tmp_path / f"{name}.mcap", header(pairings=pairings), batch_rallies=64) as log:
                for part in parts:
                    log.append(part)
        with pytest.raises(RecordingError, match=r"a\.mcap and b\.mcap share some of their rallies; read them one by one"):
            RallyLog(tmp_path)
