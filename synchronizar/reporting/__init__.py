"""What people read: evaluations, tables, pictures."""
