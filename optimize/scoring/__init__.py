"""Scores of designs on transport tables, their derivatives and their uncertainty."""
