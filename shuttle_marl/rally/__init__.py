"""Played rallies: the two types that hold them, playing one stroke at a time, and the analysis of one rally."""
