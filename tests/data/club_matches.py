"""Matches of a club as it would write them down: simulated, with German headers and words, semicolons and decimal commas."""

import csv
from pathlib import Path

import pyarrow as pa

from shuttle_marl.data.schema import REASONS
from shuttle_marl.data.simulated import simulate
from shuttle_marl.game import court, default_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import resolve

SHOT_WORDS = (
    "kurzer Aufschlag", "langer Aufschlag", "Clear", "Unterhand-Clear", "Drop", "Smash", "Halbsmash", "Drive", "Treibball",
    "Töten", "Stopp", "Block", "Cross-Stopp",
)  # fmt: skip
HEIGHT_WORDS = ("unten", "oben")
TECHNIQUE_WORDS = ("Vorhand", "Rückhand", "über Kopf")
ENDING_WORDS = {"out": "Aus", "net": "Netz", "short": "zu kurz", "landed": "Punkt"}
HEADERS = {
    "match": "Spiel", "game": "Satz", "rally": "Ballwechsel", "stroke": "Schlag", "player": "Spielerin", "shot": "Schlagart",
    "height": "Treffpunkt", "technique": "Seite", "ending": "Ende", "landing_x": "Ziel quer", "landing_y": "Ziel längs",
}  # fmt: skip


def strokes_of_club(matches: int, seed: int = 0, game: Game | None = None) -> pa.Table:
    """Strokes of matches between players of no published data set, who play as elite players do."""
    game = game or default_game()
    average = tabulate(resolve("bc", game), game)
    return simulate(game, dict.fromkeys(("anna-beispiel", "berta-muster", "clara-probe"), average), matches=matches, seed=seed)


def write_club(folder: Path, strokes: pa.Table, *, areas_only: bool = False) -> tuple[Path, Path]:
    """The CSV file and its map."""
    headers = dict(HEADERS)
    if areas_only:
        headers = {name: header for name, header in headers.items() if not name.startswith("landing")} | {"area": "Feld"}
    rows = []
    for stroke in strokes.to_pylist():
        reason = REASONS[stroke["reason"]]
        row = {
            "match": stroke["match"], "game": stroke["game"], "rally": stroke["rally"], "stroke": stroke["stroke"],
            "player": stroke["player"].replace("-", " ").title(), "shot": SHOT_WORDS[stroke["shot"]],
            "height": HEIGHT_WORDS[stroke["height"]], "technique": TECHNIQUE_WORDS[stroke["technique"]],
            "ending": ENDING_WORDS.get(reason, ""), "area": court.AREAS[stroke["area"]],
            **{f"landing_{axis}": f"{stroke[f'landing_{axis}']:.3f}".replace(".", ",") for axis in "xy"},
        }  # fmt: skip
        rows.append({header: row[name] for name, header in headers.items()})
    file, columns = folder / "verein.csv", folder / "spalten.toml"
    with file.open("w", encoding="utf-8-sig", newline="") as out:
        writer = csv.DictWriter(out, list(headers.values()), delimiter=";")
        writer.writeheader()
        writer.writerows(rows)
    values = {
        "shot": dict(zip(SHOT_WORDS, SHOTS, strict=True)),
        "height": dict(zip(HEIGHT_WORDS, HEIGHTS, strict=True)),
        "technique": dict(zip(TECHNIQUE_WORDS, TECHNIQUES, strict=True)),
        "ending": {word: reason for reason, word in ENDING_WORDS.items()},
    }
    lines = ['source = "our club"', 'discipline = "WS"', 'delimiter = ";"', 'decimal = ","', "[columns]"]
    lines += [f'{name} = "{header}"' for name, header in headers.items()]
    for name, words in values.items():
        lines += [f"[values.{name}]", *(f'"{word}" = "{meant}"' for word, meant in words.items())]
    columns.write_text("\n".join(lines), encoding="utf-8")
    return file, columns
