"""What can be known of somebody's model before its first sample: from its script, and from a trial run."""
