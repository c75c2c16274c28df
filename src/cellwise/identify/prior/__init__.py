"""From a model of another cell of the kind to this cell's, with whatever data there are."""
