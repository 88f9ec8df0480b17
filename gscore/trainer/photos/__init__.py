"""The photos of a capture as steps want them: in which order, at which size, from where."""
