"""Skeleton estimation: the joints between rigid parts, their centres and the poses."""
