"""The page of a diagnosis: findings, pictures, logs before and after, where the error lies."""
