"""Many recordings at once: which they are, jobs on all cores or on a cluster, results that outlive an interruption."""
