"""From a file's bytes to the channels of a log: sources, columns, text, parquet, assembly."""
