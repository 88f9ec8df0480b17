"""Readers and writers of files; numpy only, one format a module."""
