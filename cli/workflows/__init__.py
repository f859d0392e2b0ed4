"""What commands run from end to end."""
