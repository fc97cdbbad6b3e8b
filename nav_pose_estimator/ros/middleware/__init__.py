"""What a node has to know of the middleware below it."""
