"""Other people's estimators behind the protocol of `serve.py`, each by an adapter of its own."""
