"""Dimensions of the court and the net in the Laws of Badminton (BWF, Law 1), in metres."""

import pytest

from shuttle_marl.game import court


@pytest.mark.parametrize(
    ("name", "metres"),
    [
        ("LENGTH", 13.4),
        ("WIDTH", 6.1),
        ("SINGLES_WIDTH", 5.18),
        ("NET_HEIGHT", 1.55),
        ("NET_HEIGHT_CENTRE", 1.524),
        ("SHORT_SERVICE", 1.98),
        ("LONG_SERVICE", 0.76),
        ("LINE", 0.04),
        ("NET_DEPTH", 0.76),
        ("TAPE", 0.075),
    ],
)
def test_dimensions_are_those_of_the_laws(name: str, metres: float) -> None:
    assert getattr(court, name) == metres
