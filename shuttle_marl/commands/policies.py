"""All policies by name, with one line about each."""

from typing import Final

import tyro
from rich.table import Table
from rich.text import Text

from shuttle_marl.base.errors import printable
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import GameOptions

_DEFAULT: Final = GameOptions()
_OWN: Final = {
    "MODULE:ATTRIBUTE": "policy of your own: an object, class or function in a module in this folder or installed",
    "NAME@TEMPERATURE": "any of them, sharper below 1 and flatter above, such as bc@0.5",
    "NAME@greedy": "any of them, always its likeliest stroke",
}


def policies(*, model: tyro.conf.OmitArgPrefixes[GameOptions] = _DEFAULT, json: bool = False) -> None:
    """List all policies by name: those of a game, and how to name your own.

    Args:
        model: the game.
        json: print JSON.
    """
    from shuttle_marl.policy.registry import described_names, forms  # noqa: PLC0415  keeps --help quick

    named = described_names(model.load())
    own = {**forms(), **_OWN}
    if json:
        cli.print_json({"policies": named, "forms": own})
        return
    out = cli.console()
    for title, lines in (("Policies by name", named), ("Names that you complete", own)):
        table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column()
        for name, about in lines.items():
            table.add_row(Text(printable(name), "bold"), Text(printable(about)))
        out.print(table)


COMMANDS: Final = policies


main: Final = cli.entry_point(COMMANDS, "shuttle-marl policies", __doc__ or "")
