"""Quality of staged rallies, and speed of the staging.

    python -m benchmarks.staging [--rallies N] [--quick] [--json]

Matches between two behaviour-cloned players are staged rally by rally, right- and left-handers, male and female athletes in
turn, and measured as motion: positions, rotations, and the path of the shuttle. Each is packed and unpacked again, and every
tenth one is staged stroke by stroke as in live play. Seconds are CPU seconds of the process, which has one thread (set
OMP_NUM_THREADS=1).
"""

import dataclasses
import itertools
import time
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import tyro
from rich.console import Console
from rich.progress import track

from docs.tools.results import Json, show, this_machine
from shuttle_marl.court.staging import Motion, continue_motion, stage
from shuttle_marl.court.staging.skeleton import ATHLETES
from shuttle_marl.game import default_game, draws
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.rally import Rally
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.kernel import Matches, play_matches
from shuttle_marl.policy.registry import resolve
from tests.staging.motion_metrics import Metrics, measure
from tests.staging.reader import Read, read

_HANDS: Final = ("right", "right", "left")
_QUICK: Final = 40
_CONTINUED: Final = 10  # interval of the rallies that are also continued stroke by stroke


def run(rallies: int, seed: int, console: Console) -> dict[str, Any]:
    """Stage rallies and measure them; lengths are in metres unless the key names another unit."""
    played = list(itertools.islice(match_rallies(seed), rallies))
    stage(played[0], seed=0, athletes=ATHLETES)  # solves the libraries of poses, which are cached
    cpu, size, error, found = 0.0, 0, 0.0, []
    extensions: list[float] = []
    for i, right in enumerate(track(played, "staging", console=console)):
        rally = dataclasses.replace(right, hands=(_HANDS[i % 3], _HANDS[i // 3 % 3]))
        athletes = (ATHLETES[i % 2], ATHLETES[i // 2 % 2])
        begun = time.process_time()
        motion = stage(rally, seed=i, athletes=athletes)
        cpu += time.process_time() - begun
        found.append(measure(motion))
        packed = motion.pack()
        size += len(packed)
        error = max(error, pack_error(motion, read(packed)))
        if i % _CONTINUED == 0:
            extensions += continued(rally, i, athletes)
    figures = summary(found)
    return {
        **this_machine(),
        **figures,
        "pack_kb_per_s": size / 1024 / figures["seconds"],
        "pack_error_mm": 1000 * error,
        "continue_ms": 1000 * float(np.median(extensions)),
        "realtime": figures["seconds"] / cpu,
    }


def summary(found: Sequence[Metrics]) -> dict[str, Any]:
    """Figures over several motions.

    Args:
        found: the measures of each, at least one.

    Returns:
        ``rallies``, ``strokes``, ``plants`` (of a foot) and ``seconds`` that were measured; ``contact_max``, ``slide_max``,
        ``sunk_max``, ``net_clearance_min``, ``landing_error_max`` [m]; ``speed_max`` [m/s], ``acceleration_max`` [m/s²],
        ``joint_excess_deg``; shares ``contact_within_1cm``, ``ends_as_it_must`` and ``flight_times_in_quartiles``.

        Figures without data (no stroke crosses the net, none is returned) are left out.
    """

    def every(name: str) -> npt.NDArray[Any]:
        return np.concatenate([np.atleast_1d(getattr(metrics, name)) for metrics in found])

    figures: dict[str, Any] = {
        "rallies": len(found),
        "strokes": len(every("contact")),
        "seconds": float(every("seconds").sum()),
        "contact_within_1cm": float((every("contact") <= 0.01).mean()),
        "plants": len(every("slide")),
        "joint_excess_deg": float(every("joint_excess").max()),
        "landing_error_max": float(every("landing").max()),
        "ends_as_it_must": float(every("true_end").mean()),
        **{f"{name}_max": float(every(name).max()) for name in ("contact", "slide", "sunk", "speed", "acceleration")},
    }
    if len(clearance := every("clearance")):
        figures["net_clearance_min"] = float(clearance.min())
    if len(timely := every("timely")):
        figures["flight_times_in_quartiles"] = float(timely.mean())
    return figures


def match_rallies(seed: int) -> Iterator[Rally]:
    """Rallies of matches between two behaviour-cloned players, match after match."""
    game = default_game()
    table = tabulate(resolve("bc", game), game)
    for match in itertools.count():
        key = draws.stream(seed, np.array([match]))
        entrants, server = np.zeros((1, 2), np.int32), np.array([match % 2], np.int8)
        rallies = play_matches(game, Matches(entrant=entrants, first_server=server, key=key), [table]).rallies
        yield from (dataclasses.replace(rallies.row(k, game.catalogue), match=match) for k in range(len(rallies)))


def pack_error(motion: Motion, again: Read) -> float:
    """Maximum distance between strings, bones and shuttles of a motion and what is read of it [m]."""
    names = ("sweet_spot", "position", "shuttle")
    return max(float(np.linalg.norm(getattr(motion, name) - getattr(again, name), axis=-1).max()) for name in names)


def continued(rally: Rally, seed: int, athletes: tuple[str, str]) -> list[float]:
    """CPU seconds of each extension of a rally staged during play, by a stroke and the reply."""
    motion = stage(first_strokes(rally, 0), seed=seed, athletes=athletes)
    seconds = []
    for k in range(2, len(rally) + 2, 2):
        grown = first_strokes(rally, min(k, len(rally)))
        begun = time.process_time()
        motion = continue_motion(motion, grown, seed=seed)
        seconds.append(time.process_time() - begun)
    return seconds


def first_strokes(rally: Rally, strokes: int) -> Rally:
    """The first strokes of a rally, as an open rally."""
    if strokes == len(rally):
        return rally
    ending = int(rally.outcome[strokes - 1]) if strokes else RETURNED_BELOW
    return dataclasses.replace(rally, stroke=rally.stroke[:strokes], hurried=rally.hurried[:strokes], ending=ending)


def main(*, rallies: int = 1000, quick: bool = False, as_json: Json = False) -> None:
    """Measure and print.

    Args:
        rallies: number of staged rallies.
        quick: stage 40 rallies.
        as_json: print JSON instead of a table.
    """
    show(run(_QUICK if quick else rallies, 0, Console(stderr=True)), "staging", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
