"""Node trees built in Python: filters, colours, materials, display."""
