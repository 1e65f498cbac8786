"""The athletes: skinned models and skeletons, baked from a CC0 base mesh. ``README.md`` says where they come from."""
