"""Pictures as bytes: whole, of a bearable size and of known formats, or refused in words."""
