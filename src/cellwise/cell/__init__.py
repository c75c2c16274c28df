"""What a cell is: model, equations, effects, simulation."""
