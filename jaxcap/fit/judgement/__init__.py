"""Judgement of a posed body's fit to a cloud, by part, compared with the normal values of a sequence."""
