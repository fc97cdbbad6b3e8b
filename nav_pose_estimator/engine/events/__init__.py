"""Every event there is, in words."""
