"""How fast domains are made and read, and what faults cost."""
