"""A capture cut into blocks that are trained by themselves, and what comes of them put together."""
