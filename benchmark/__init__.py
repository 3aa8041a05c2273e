"""Run, score, compare methods that estimate articulated motion."""
