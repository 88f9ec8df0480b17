"""Pictures of verbs: cameras, file names, stills, videos and pages."""
