"""The figures of the package's size."""

from docs.tools import size
from docs.tools.markdown import ROOT


def test_files_of_a_stroke_and_no_imports_in_a_loop() -> None:
    found = size.modules(ROOT)
    parts = size.files_of(ROOT, found, size.STROKE)
    assert size.circles(found, ROOT) == []
    assert "tables.py" in {path.name for path in parts}
    assert len(parts) <= 4, sorted(path.name for path in parts)
