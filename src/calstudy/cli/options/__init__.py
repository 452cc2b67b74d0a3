"""What each command takes, apart from what it does: a command's help loads nothing that it works with."""
