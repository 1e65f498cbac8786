"""Draws the simulated sample: matches between policies of the package, as a stroke table in the strict schema.

    python datasets/make_sample.py

writes ``datasets/sample/strokes.parquet`` and ``datasets/sample/CARD.md`` beside it. No annotated data is needed: the game
and the policies come with the package. The same flags give the same bytes.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl import __version__
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.data.schema import Account, Outcome
from shuttle_marl.data.simulated import simulate
from shuttle_marl.data.table import write_parquet
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.policy.registry import resolve

PLAYERS = ("bc", "bc:viktor-axelsen", "bc:chou-tien-chen", "bc:an-se-young", "bc:chen-yufei")
_SAMPLE = Path(__file__).parent / "sample" / "strokes.parquet"
_CARD = Path(__file__).parent / "sample" / "CARD.md.in"  # for str.format


def player_of(policy: str) -> str:
    """Name of a player in the table: ``bc:viktor-axelsen`` plays as ``viktor-axelsen``, ``bc`` as itself."""
    return policy.partition("@")[0].rpartition(":")[2]


def make_sample(*, players: tuple[str, ...] = PLAYERS, matches: int = 8, seed: int = 0, out: Path = _SAMPLE) -> None:
    """Play matches between policies and write every stroke down.

    Args:
        players: Names of policies, at least two; those named after players meet players of their discipline.
        matches: Number of matches, best of three games to 21.
        seed: Of all draws.
        out: The Parquet file; CARD.md is written beside it.
    """
    game = default_game()
    policies = {player_of(name): tabulate(resolve(name, game), game) for name in players}
    strokes = simulate(game, policies, matches=matches, seed=seed)
    account = Account.of(strokes)
    provenance = {
        "simulated_by": f"shuttle_marl {__version__}",
        "policies": list(players),
        "game": game.hash,
        "seed": seed,
        "licence": "MIT",
    }
    write_parquet(strokes, out, account=account, provenance=provenance)
    text = card(strokes, account, provenance, size=out.stat().st_size)
    replace_file(out.with_name("CARD.md"), text.encode())
    sys.stdout.write(f"{out}: {strokes.num_rows} strokes, {out.stat().st_size} bytes\n")


def card(strokes: pa.Table, account: Account, provenance: Mapping[str, Any], *, size: int) -> str:
    """The card of a sample, in Markdown."""
    counts = sorted(pc.value_counts(strokes["shot"]).to_pylist(), key=lambda item: -item["counts"])
    return _CARD.read_text(encoding="utf-8").format(
        strokes=strokes.num_rows,
        rallies=account.rallies,
        games=strokes.group_by(["match", "game"]).aggregate([]).num_rows,
        matches=account.matches,
        size=size,
        seed=provenance["seed"],
        made_by=provenance["simulated_by"],
        players=" ".join(provenance["policies"]),
        game=provenance["game"],
        length=strokes.num_rows / account.rallies,
        faults=pc.mean(pc.equal(strokes["outcome"], Outcome.FAULT)).as_py(),
        winners=pc.mean(pc.equal(strokes["outcome"], Outcome.WINNER)).as_py(),
        shots=", ".join(f"{SHOTS[c['values']]} {c['counts'] / strokes.num_rows:.0%}" for c in counts[:5]),
    )


if __name__ == "__main__":
    sys.exit(cli.run(make_sample, prog="datasets/make_sample.py", description=__doc__ or ""))
