"""Image files: decoding with limits on size and format, masks, PNG, EXIF."""
