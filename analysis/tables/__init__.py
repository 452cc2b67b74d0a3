"""One module for each table of the paper, and for those that go beyond it."""
