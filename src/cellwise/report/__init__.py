"""Pictures and self-contained pages (needs the extra ``report``: matplotlib)."""
