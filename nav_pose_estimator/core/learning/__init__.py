"""The neuro-fuzzy network and how it is trained."""
