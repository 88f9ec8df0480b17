"""The Python that trains: found, checked and made."""
