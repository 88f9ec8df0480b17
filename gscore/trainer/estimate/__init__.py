"""What a training will take, in seconds and in memory; nothing here needs torch."""
