"""Terminal of a verb: streams, progress lines, events, signals."""
