"""The tables of the documentation come from results."""

import re

from docs.tools.markdown import ROOT


def test_no_page_states_a_probability_beyond_100_percent() -> None:
    """Normal intervals of probabilities are cut at 0 and 100 %, and exploitability is a value from 0 to 1 everywhere."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text(encoding="utf-8")
        beyond = [number for number in re.findall(r"(\d+\.\d+) (?:% )?(?:to \d|\))", text) if 100 < float(number) < 101]
        assert beyond == [], path
        assert not re.findall(r"exploitab\w+ (?:of |is |about )?\d+(?:\.\d+)? %", text), path
