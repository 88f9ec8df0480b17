"""Photo parameters and rendering: exposure gains, camera poses, blurs, transients, renderer."""
