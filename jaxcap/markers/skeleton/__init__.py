"""The skeleton that connects the segments."""
