"""The command ``calstudy``: one module a command, with its own options."""
