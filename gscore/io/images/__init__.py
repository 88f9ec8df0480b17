"""Image files: decoding with limits of size and format, masks, PNG, EXIF."""
