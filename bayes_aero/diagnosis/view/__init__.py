"""What is shown of a diagnosis: everything computed, as plain data for tables, figures and pages."""
