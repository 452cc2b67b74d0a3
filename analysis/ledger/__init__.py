"""The ledger: whether the paper's statements hold in a study."""
