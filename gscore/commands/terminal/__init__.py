"""What a verb says and hears: streams, lines on a terminal, events, signals."""
