"""For coaches: the scouting report and the match report as pages. See ``docs/coach.md``."""
