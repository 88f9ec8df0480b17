"""Photo parameters and rendering: exposure gains, camera poses, track colours, model renderer."""
