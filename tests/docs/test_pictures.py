"""Pictures of the documentation: every one has data, and is drawn again when they change."""

from docs.tools import pictures
from docs.tools.markdown import IMAGES


def test_no_picture_is_older_than_its_data() -> None:
    assert pictures.outdated() == []


def test_every_picture_of_a_page_exists() -> None:
    shown = {name for names in pictures.PICTURES for name in names}
    assert shown == {path.name for path in IMAGES.iterdir()} - {"sources.json"}
