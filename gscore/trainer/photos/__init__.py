"""Photos of a training: loading, sampling order, image pyramid, sky."""
