"""renderer/dataset."""
