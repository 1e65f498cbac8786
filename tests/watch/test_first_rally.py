"""The rally that a new server shows before anything is compiled."""

import msgspec
import numpy as np

from docs.tools.first_rally import first_rally
from shuttle_marl.staging import Motion
from shuttle_marl.watch.first_rally import shipped_rally


def test_the_shipped_rally_is_that_of_the_default_match() -> None:
    expected = first_rally()
    found = shipped_rally(expected.key)
    assert found is not None, "run python -m docs.tools.first_rally"
    assert msgspec.json.encode(found.reply) == msgspec.json.encode(expected.reply)
    shown, staged = Motion.unpack(found.motion), Motion.unpack(expected.motion)
    np.testing.assert_allclose(shown.position, staged.position, atol=0.01)
    np.testing.assert_allclose(shown.shuttle, staged.shuttle, atol=0.01)
