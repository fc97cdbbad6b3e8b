"""GNSS outages: methods that learn the vehicle's motion while GNSS is good, their rehearsals, and their use."""
