"""Athletes of the package: skinned models and skeletons, baked from a CC0 base mesh.

See ``shuttle_marl/staging/athletes/README.md`` for the source and the licence of the base mesh.
"""
