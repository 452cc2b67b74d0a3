"""Studies that were replicated on an emulator, and other studies beside them."""
