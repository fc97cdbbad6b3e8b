"""What arrives, in order, and what a node leaves out when that is more than it can take."""
