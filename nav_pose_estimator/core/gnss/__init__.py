"""What can be believed of GNSS: quality gate, return after an outage, slow drift."""
