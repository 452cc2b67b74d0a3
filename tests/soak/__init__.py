"""A harness that injects failures, kills at random and corrupts what is read; ``scripts/soak`` runs it."""
