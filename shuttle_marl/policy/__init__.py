"""Policies: the contract, tables, and the players that come with the package."""
