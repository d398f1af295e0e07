"""Judgement of a posed body's fit to a cloud, by part, compared with the baseline of a sequence."""
