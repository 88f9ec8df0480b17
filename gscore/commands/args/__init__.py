"""Arguments of verbs: options of a run, captures, models, and the option names of 3DGS."""
