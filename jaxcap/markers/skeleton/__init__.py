"""The skeleton between segments."""
