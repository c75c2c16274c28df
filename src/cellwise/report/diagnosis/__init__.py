"""The page of a diagnosis: findings, pictures, logs before and after, anatomy of the error."""
