"""How fast domains are made and read."""
