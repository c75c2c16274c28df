"""The fixed step in Python printed as C99."""
