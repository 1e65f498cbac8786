"""Athletes of the package: skinned models and skeletons, baked from a CC0 base mesh.

``shuttle_marl/staging/athletes/README.md`` says where the base mesh comes from and under which licence.
"""
