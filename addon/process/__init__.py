"""Background processes and threads, the poll timer for their results, incremental tasks."""
