"""What is learned while GNSS is good, rehearsed, and used when it is lost."""
