"""The fixed step in float32: the source of the C twin in ``firmware_ref``."""
