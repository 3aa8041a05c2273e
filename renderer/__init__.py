"""From a moving model to pixels and their ground truth."""
