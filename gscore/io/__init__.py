"""Readers and writers of files; numpy only, one format per module."""
