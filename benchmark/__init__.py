"""Run, score, compare. Built by a later issue; see the README."""
