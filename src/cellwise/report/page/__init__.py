"""What every page is made of: markup, style, pictures, plots that zoom, numbers as text."""
