"""Pictures that verbs make: which cameras, under which names, as stills, videos and pages."""
