"""Lives: capacity and resistance of a cell from whatever windows its logs offer."""
