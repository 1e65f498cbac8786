"""All policies by name, with one line about each."""

from typing import Final

from shuttle_marl.commands import cli
from shuttle_marl.commands.options import MODEL, Model

_OWN: Final = {
    "MODULE:ATTRIBUTE": "policy of your own: an object, class or function in a module in this folder or installed",
    "NAME@TEMPERATURE": "any of them, sharper below 1 and flatter above, such as bc@0.5",
    "NAME@greedy": "any of them, always its likeliest stroke",
}


def policies(*, model: Model = MODEL, json: bool = False) -> None:
    """List all policies by name: those of a game, and how to name your own.

    Args:
        model: the game.
        json: print JSON.
    """
    from shuttle_marl.policy.registry import described_names, forms  # noqa: PLC0415  keeps --help quick

    named = described_names(model.load())
    own = {**forms(), **_OWN}
    titles = ("Policies by name", named), ("Names that you complete", own)
    cli.show({"policies": named, "forms": own}, json, *(cli.table(title, ("name", "policy"), of.items()) for title, of in titles))


COMMANDS: Final = policies
main: Final = cli.entry_point(COMMANDS, "shuttle-marl policies", __doc__ or "")
