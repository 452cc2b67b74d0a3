"""Advice for people: terminal, page and pictures."""
