"""Which causes are accepted: candidates compared, acceptance, revision, the outcome."""
