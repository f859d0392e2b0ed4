"""Data as files: columns and shards, a domain's folder, pictures, recordings to convert, formats to export to."""
