"""The jobs of the command line: each reads records, computes, and writes a folder of results."""
