"""The ledger: whether the paper's claims hold in a study."""
