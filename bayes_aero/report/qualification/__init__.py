"""The page, tables and sentences of a qualification."""
