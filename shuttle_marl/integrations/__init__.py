"""Adapters to other libraries; each module needs its library."""
