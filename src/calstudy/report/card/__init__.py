"""A calibrated material as one file that another machine can read and check."""

from calstudy.report.card.card import SCHEMA, Card, card_of, read_card, write_card
from calstudy.report.card.check import Verdict, models_of, verdicts
from calstudy.report.card.holdout import holdout_in_words, holdout_table

__all__ = [
    "SCHEMA",
    "Card",
    "Verdict",
    "card_of",
    "holdout_in_words",
    "holdout_table",
    "models_of",
    "read_card",
    "verdicts",
    "write_card",
]
