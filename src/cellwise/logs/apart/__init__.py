"""Files read in a process of their own, where the library that reads them cannot be trusted."""
