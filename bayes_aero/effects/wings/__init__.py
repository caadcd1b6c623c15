"""A left and a right wing that stall at different angles: see `Model.flow`."""
