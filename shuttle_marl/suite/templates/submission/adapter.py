"""A method for adapt-v1: the best response to the known opponent under which the observed strokes are likeliest."""

from typing import Any

import numpy as np

from shuttle_marl.exact import best_response


class Adapter:
    """Constructed with the setting for each opponent."""

    def __init__(self, setting: Any) -> None:
        self.types = list(setting.known.values())
        self.log_likelihood = np.zeros(len(self.types))
        self.responses: dict[int, Any] = {}

    def policy_for_next_rally(self) -> Any:
        """What to play from the next rally on."""
        likeliest = int(self.log_likelihood.argmax())
        if likeliest not in self.responses:
            self.responses[likeliest] = best_response(self.types[likeliest], tolerance=1e-6).policy
        return self.responses[likeliest]

    def observe_rally(self, rally: Any) -> None:
        """Look at the opponent's strokes."""
        pairs = rally.pair[~rally.own]
        self.log_likelihood += [np.log(np.maximum(each.probability_of(pairs), 1e-4)).sum() for each in self.types]
