"""LIGGGHTS models, one folder each: input script, fidelities and variants as data, notes on the choices."""
