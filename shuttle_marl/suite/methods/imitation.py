"""Baselines of ``imitate``."""

import dataclasses

from shuttle_marl.analysis.tabular import SHRINK, cloned
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.suite.imitate import HumanStrokes, ImitateSetting


@dataclasses.dataclass(frozen=True)
class Counts:
    """Shrunken counts; the argument is the number of pseudo-observations of the coarser cell."""

    setting: ImitateSetting
    argument: str = str(SHRINK)

    def fit(self, strokes: HumanStrokes) -> PairPolicy:
        """The counts."""
        return PairPolicy(game=strokes.game, probability=cloned(strokes.game, strokes.pair, shrink=float(self.argument)))


@dataclasses.dataclass(frozen=True)
class Named:
    """A policy of the package, ``bc`` by default: the argument is its name."""

    setting: ImitateSetting
    argument: str = "bc"

    def fit(self, strokes: HumanStrokes) -> str:  # noqa: ARG002
        """Its name."""
        return self.argument
