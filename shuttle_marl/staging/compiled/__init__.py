"""Inner loops of the staging, compiled.

One arm, one leg, one frame at a time, in plain loops over numbers: on the few frames that follow a stroke, arrays would spend
their time in calls. All of it is imported where it is called, as numba is slow to import.
"""
