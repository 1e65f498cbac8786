"""shuttle_marl: two-player badminton for multi-agent reinforcement learning, learned from elite matches."""

__version__ = "0.1.0"
