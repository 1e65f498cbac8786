"""From a rally to motion."""
