"""Results to HTML."""
