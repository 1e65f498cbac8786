"""Played rallies: records as columns and as single rallies, and a stepper that plays one stroke at a time."""
