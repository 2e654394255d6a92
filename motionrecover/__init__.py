"""Recover the human motion that really happened."""
