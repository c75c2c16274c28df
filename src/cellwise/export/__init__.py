"""A CellModel as C sources that a target compiles, with what they cost and what they lose."""
