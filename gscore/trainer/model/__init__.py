"""The splats in training: their rows, where these come from, and what keeps them healthy."""
