"""What a study that was replicated on an emulator shows, and how another study compares with it."""
